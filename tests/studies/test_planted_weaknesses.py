"""The study of planted weaknesses: what it plants, and how it judges."""

from __future__ import annotations

import numpy as np

from sada_gym.parameters import Mu
from studies.planted_queries import ADVERSARIES, ask
from studies.planted_settings import PlantedApplication, plant
from studies.planted_weaknesses import judge, tables


def test_planted_weaknesses_have_volume_and_fool_as_often_as_they_say():
    for seed in range(6):
        setting = plant(seed)
        assert all(0.02 <= weakness.volume <= 0.25 for weakness in setting.planted)
        mu: Mu = np.random.default_rng(0).uniform(-1, 1, (2_000, len(setting.space)))
        outcomes = PlantedApplication(setting).evaluate(mu, range(2_000))
        rates = setting.rates((mu + 1) / 2)
        assert abs(outcomes.fooled.mean() - rates.mean()) < 0.04


def test_adversaries_ask_as_many_worlds_inside_the_box():
    for adversary in ADVERSARIES:
        known = ask(plant(3), adversary, np.random.default_rng(0))
        assert known.shares.shape == (2_250, len(plant(3).space))
        assert known.shares.min() >= 0 <= 1 - known.shares.max()
        if adversary != "random":  # all of whose worlds are uniform
            assert known.fooled[known.uniform].mean() < known.fooled[~known.uniform].mean()


def test_true_rules_are_found_and_others_false():
    setting = plant(1)
    assert len(setting.planted) > 1
    true = [weakness.contains for weakness in setting.planted]
    judged = judge(setting, [*true, lambda shares: ~np.any([r(shares) for r in true], axis=0)])
    assert judged["one"] == judged["together"] == [1.0] * len(true)
    assert judged["within"] == [1.0] * len(true) + [0.0]
    nothing = judge(setting, [])
    assert nothing["one"] == [0.0] * len(true)
    checked = {"fresh": 45, "inside": [True, False], "outside": [True]}
    row = {
        "adversary": "random",
        "dimension": len(setting.space),
        "kinds": [weakness.kind for weakness in setting.planted],
        "found": {
            "sada-gym": {**judged, **checked, "seconds": 1.0, "groups": len(true) + 1},
            "PRIM": {**nothing, "seconds": 1.0},
            "decision tree": {**nothing, "seconds": 1.0},
        },
    }
    ours, prim = tables([row]).splitlines()[2:4]
    assert "| sada-gym | 100.0 % (" in ours
    assert "| PRIM | 0.0 % (" in prim
    assert "| 45 | 50.0 % (" in tables([row])
    assert f"| {len(true)} | 1 | {len(true) + 1}.0 | 0.0 %" in tables([row])
