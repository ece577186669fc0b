"""A new application is a folder and one edit outside it: its name in `APPLICATIONS`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import sada_gym

PACKAGE = Path(sada_gym.__file__).parent
TOY = Path(__file__).parents[1] / "support" / "toy_application"

USES = """
from pathlib import Path

import gymnasium as gym
import sada_gym
from leaderboard import tables
from sada_gym import attack
from sada_gym.board.benchmark.suite import find_suite
from sada_gym.foundations.cards import find_card
from sada_gym.analyses.replay import replay

track = "SADA-Toy-Three-v0"
assert track in sada_gym.tracks()
assert gym.make(track).action_space.shape == (3,)
assert gym.make_vec("SADA-Toy-v0", num_envs=2).single_action_space.shape == (2,)
suite = find_suite("toys")
assert suite.tracks == ("SADA-Toy-Two-v0", track), suite.tracks
assert [*suite.seeds_on(track)] == [0, 1]
assert "toys" in tables.MEASURED  # which makes its folder, and so its page
comparison = tables.HEADLINES["toys"]
assert (comparison.table, comparison.agent) == ("equal-queries", ""), comparison
assert "Toys" in next(tables.side_by_side(None, ()))
Path("results").mkdir()
tables.write_tables(Path("results"), tables.results_of_suite((), "toys"))
card = find_card("SADA-Toy")
assert (card.page, card.short(track)) == ("toys", "Three")

run = attack(track, "random", budget=5, seed=0, out="run", progress=False).folder
video = replay(run, out="toy.gif")
assert video.samples[0].endings == ("the ball has stopped",), video.samples
assert len(video.frames) == 4
print("all of it")
"""


@pytest.mark.long
def test_a_folder_and_a_line_make_an_application(tmp_path: Path) -> None:
    package = tmp_path / "sada_gym"
    opened = ("envs", "foundations")
    for folder in (PACKAGE, *(PACKAGE / name for name in opened)):
        copied = package / folder.relative_to(PACKAGE)
        copied.mkdir(parents=True)
        for source in folder.iterdir():
            if source.name not in ("__pycache__", *opened, "cards.py"):
                (copied / source.name).symlink_to(source)
    (package / "envs" / TOY.name).symlink_to(TOY)
    cards = (PACKAGE / "foundations" / "cards.py").read_text(encoding="utf-8")
    end = cards.index("\n)\n", cards.index("APPLICATIONS = ("))
    edited = f'{cards[:end]}\n    "{TOY.name}",{cards[end:]}'
    (package / "foundations" / "cards.py").write_text(edited, encoding="utf-8")

    path = os.pathsep.join((str(tmp_path), str(PACKAGE.parent)))
    done = subprocess.run(
        [sys.executable, "-c", USES],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "all of it"
