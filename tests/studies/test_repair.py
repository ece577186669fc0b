"""The study of repairs keeps what it has found, and puts it into a table with intervals."""

import json

import numpy as np
import pytest

from sada_gym import GymnasiumApplication
from studies import repair as study


def act(state):
    return int(state[2] + state[3] > 0)


class Pole(study.Subject):
    """A balancer whose repair only writes a file."""

    name = "pole"
    effort = study.Effort(steps=8, nominal=2, uniform=20, budget=12, samples=4)

    def application(self, agent):
        return GymnasiumApplication(
            "CartPole-v1",
            agent=act,
            parameters={"gravity": (5.0, 20.0), "length": (0.2, 2.0)},
            score=("length", 40),
            fooling_threshold=0.9,
            max_steps=40,
            agent_id="by hand",
        )

    def base(self, folder):
        return act

    def repair(self, base, source, shares, seed, file):
        assert (source / "result.json").is_file()
        assert sum(shares.values()) == 1.0
        file.write_text("an agent")
        return file


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(study, "ATTACKERS", ("random",))
    attacked = study._attacked
    monkeypatch.setattr(
        study, "_attacked", lambda s, a, _, seed, folder: attacked(s, a, "random", seed, folder)
    )


def test_an_arm_is_done_once_and_judged_in_the_same_worlds(tmp_path, monkeypatch):
    first = study.run(Pole(), "mixed", 0, tmp_path)
    assert json.loads((tmp_path / "pole" / "mixed-0.json").read_text()) == first
    other = study.run(Pole(), "none", 0, tmp_path)
    assert other["uniform"] == first["uniform"]
    assert 0.0 <= first["cvar"] <= first["uniform"] <= 1.0
    monkeypatch.setattr(Pole, "repair", None)  # nothing is trained again
    assert study.run(Pole(), "mixed", 0, tmp_path) == first
    monkeypatch.setattr(Pole, "effort", study.Effort(9, 2, 20, 12, 4))
    with pytest.raises(SystemExit, match="Name another"):
        study.run(Pole(), "mixed", 0, tmp_path)


def test_the_table_has_intervals_over_seeds_and_of_rates(tmp_path):
    (tmp_path / "pole").mkdir()
    for seed in range(3):
        found = {"nominal": 0.5 + 0.1 * seed, "cvar": 0.1, "fooled": 5, "worlds": 20}
        found |= {"random": seed, "samples": 4}
        (tmp_path / "pole" / f"uniform-{seed}.json").write_text(json.dumps(found))
    rows = [*study.table(Pole(), tmp_path)]
    (row,) = [row for row in rows if row.startswith("| uniform")]
    assert "| 3 | 0.60 ± 0.25 | 25 (16 to 37); 25, 25, 25 |" in row
    assert "; 0, 25, 50 |" in row
    assert row.endswith("| 0.10 ± 0.00 |")
    assert not any(row.startswith("| failures") for row in rows)  # which is not there yet


def test_nominal_worlds_lie_in_the_box():
    for subject in study.SUBJECTS[1:]:
        mu, seeds = subject.nominal(5)
        assert np.abs(mu).max() <= 1.0
        assert len(mu) == len(seeds) == 5
