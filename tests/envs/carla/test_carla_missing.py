"""What a user is told who has no CARLA client."""

from __future__ import annotations

import subprocess
import sys

from sada_gym.board.submission.current import board_tracks
from sada_gym.foundations.cards import find_card

CARD = find_card("SADA-DrivingCarla")


def test_without_the_client_a_sentence_says_how_to_install_it():
    code = (
        "import sys; sys.modules['carla'] = None; import sada_gym\n"
        "from sada_gym.envs.carla.card import CARD; print(CARD.missing)\n"
        "sada_gym.make_application('SADA-DrivingCarla-v0')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 1
    assert "MissingExtra: Expected CARLA's client" in done.stderr
    for told in (done.stdout, done.stderr):
        assert "pip install -c constraints.txt '.[carla]'" in told


def test_it_never_takes_part_in_the_benchmark():
    assert CARD is not None
    assert not CARD.repeatable
    assert CARD.suite is None
    assert not CARD.board_tracks
    assert CARD.id not in board_tracks()
