"""Draw docs/images/crash.gif, the CartPole agent of docs/own-agent.md in two worlds.

    sada-gym init CartPole-v1 --steps 20000
    python -m tools.draw_crash CartPole-v1.toml

On the left its usual world, on the right late commands and a short pole.
"""

from __future__ import annotations

import sys

import numpy as np

from sada_gym.envs.wrapped.toml import read_application
from tools.draw_delay import IMAGES, write

FAILING = {"action_delay": 2, "length": 0.25}
SEED = 0


def main(path: str) -> None:
    """Replay the usual world and the failing one, side by side, until the pole falls."""
    application = read_application(path)
    usual = np.asarray(application.nominal)
    (values,) = application.parameters.physical(usual[None])
    named = dict(zip(application.parameters.names, values, strict=True))
    (failing,) = application.parameters.normalised(np.array([list((named | FAILING).values())]))
    replays = [application.replay(mu, SEED) for mu in (usual, failing)]
    print("scores", *(score for _, score in replays))
    passing, falling = (list(frames) for frames, _ in replays)
    said = "usual world", "commands 2 steps late, half the pole"
    write(passing, falling, said, "it falls", IMAGES / "crash.gif")


if __name__ == "__main__":
    main(*sys.argv[1:])
