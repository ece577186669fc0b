"""Makes an entry of the leaderboard: the same as `sada-gym submit`."""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # the clone itself, installed or not

from sada_gym.cli import app  # noqa: E402

if __name__ == "__main__":
    app(["submit", *sys.argv[1:]], prog_name="sada-gym")
