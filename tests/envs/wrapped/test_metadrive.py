"""MetaDrive, which allows one engine in a process, attacked like any other environment."""

from __future__ import annotations

import numpy as np
import pytest
from killed_runs import check_same_bits

from sada_gym import attack
from sada_gym.errors import UserError

pytest.importorskip("metadrive", reason="pip install metadrive-simulator (Python below 3.12)")
from tests.support.metadrive_toy import driving

pytestmark = pytest.mark.slow
SETTINGS = {"budget": 8, "samples": 3, "seed": 0}
SCRIPT = """
import sys
from sada_gym import attack
from tests.support.metadrive_toy import driving

if __name__ == "__main__":
    attack(driving(num_envs=1), "random", out=sys.argv[1], budget=8, samples=3, seed=0)
"""


def test_a_second_engine_is_told_by_what_fixes_it():
    with pytest.raises(UserError, match=r"Set num_envs=1.*after engine initialization"):
        driving()


def test_a_batch_has_the_scores_of_each_world_alone():
    application = driving(num_envs=1)
    mu = np.random.default_rng(0).uniform(-1, 1, (3, 2)).astype(np.float32)
    together = application.evaluate(mu, range(3))
    alone = [application.evaluate(mu[i : i + 1], [i]).score[0] for i in range(3)]
    assert together.score.tolist() == alone
    assert not together.invalid


def test_workers_and_a_killed_run_have_the_same_bits(tmp_path):
    def attack_in(folder, **options):
        return attack(driving(num_envs=1), "random", out=folder, **options, **SETTINGS)

    check_same_bits(tmp_path, 11, SCRIPT, attack_in)
