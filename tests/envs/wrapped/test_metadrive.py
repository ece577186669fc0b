"""MetaDrive, which allows one engine in a process, attacked like any other environment."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing

import numpy as np
import pytest

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


def test_a_second_engine_is_told_by_what_mends_it():
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
    (tmp_path / "run.py").write_text(SCRIPT)
    path = {"PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path])}
    command = [sys.executable, str(tmp_path / "run.py"), str(tmp_path / "killed")]
    process = subprocess.Popen(command, env={**os.environ, **path})
    while process.poll() is None and committed(tmp_path / "killed" / "run.sqlite") < 3:
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert 3 <= committed(tmp_path / "killed" / "run.sqlite") < 11
    runs = [
        attack(driving(num_envs=1), "random", out=tmp_path / name, **options, **SETTINGS)
        for name, options in {
            "killed": {"resume": True},
            "one": {},
            "two": {"workers": 2},
        }.items()
    ]
    for run in runs[1:]:
        assert (run.samples.score == runs[0].samples.score).all()
        assert (run.queries.score == runs[0].queries.score).all()


def committed(store):
    try:
        with closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True)) as connection:
            return connection.execute("SELECT count(*) FROM evaluation").fetchone()[0]
    except sqlite3.Error:
        return 0
