"""Several requirements as one score: margins, what fails together, and what is refused."""

import numpy as np
import pytest
from wrapped_toys import balance

from sada_gym import GymnasiumApplication, attack, export, regress
from sada_gym.envs.wrapped import ObservationNoise
from sada_gym.envs.wrapped.several import EDGE, margin
from sada_gym.envs.wrapped.toml import read_application


def calm(episode):
    actions = np.array(episode.actions)
    return 1.0 - float(np.mean(actions[1:] != actions[:-1]))


SCORES = {"up": ("length", 100), "calm": calm, "earned": ("return", 0.0, 100.0)}
THRESHOLDS = {"up": 0.9, "calm": 0.3, "earned": 0.7}
RANGES = {"force_mag": (1.0, 20.0), "noise": ObservationNoise(0.0, 1.0)}


def pole(**changes):
    arguments = {
        "agent": balance,
        "agent_id": "by hand",
        "parameters": RANGES,
        "score": SCORES,
        "fooling_threshold": THRESHOLDS,
        "max_steps": 100,
    }
    return GymnasiumApplication("CartPole-v1", **arguments | changes)


@pytest.mark.parametrize("threshold", [0.0, 1e-9, 0.1, 0.3, 0.5, 0.7, np.nextafter(1.0, 0.0)])
def test_a_margin_keeps_the_verdict_to_the_last_bit(threshold):
    beside = [np.nextafter(threshold, 0.0), threshold, np.nextafter(threshold, 1.0)]
    scores = np.unique([0.0, *beside, *np.linspace(0.0, 1.0, 97)])
    margins = np.array([margin(float(q), threshold) for q in scores])
    assert ((scores <= threshold) == (margins <= EDGE)).all()
    assert (np.diff(margins) >= 0.0).all()
    assert margins[0] == 0.0
    assert margins[-1] == 1.0
    if threshold:
        assert margin(threshold, threshold) == EDGE


def test_a_world_fails_exactly_where_a_requirement_fails_alone():
    mu = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 2)).astype(np.float32)
    seeds = [*range(12)]
    alone = {
        name: pole(score=SCORES[name], fooling_threshold=THRESHOLDS[name]).evaluate(mu, seeds)
        for name in SCORES
    }
    together = pole().evaluate(mu, seeds)
    failing = np.array([outcomes.fooled for outcomes in alone.values()])
    assert together.fooled.tolist() == failing.any(axis=0).tolist()
    assert 0 < together.fooled.sum() < 12
    assert failing.sum(axis=0).max() > 1, "some must fail together"
    for i, info in enumerate(together.infos):
        margins = info["requirements"]
        assert info["score"] == min(margins.values())
        assert margins == {name: margin(alone[name].score[i], THRESHOLDS[name]) for name in margins}
    named = pole(requirement="up").evaluate(mu, seeds)
    assert named.fooled.tolist() == alone["up"].fooled.tolist()
    assert [info["requirements"] for info in named.infos] == [
        info["requirements"] for info in together.infos
    ]
    for text, fails in zip(pole().behaviours(mu, seeds), failing.T, strict=True):
        names = [name for name, one in zip(SCORES, fails, strict=True) if one]
        assert text.events == ((f"fails {' and '.join(names)}",) if names else ())


def test_worlds_that_are_not_computed_have_all_margins():
    application = pole(feasible="force_mag < 15.0")
    infos = application.evaluate([[1.0, 0.0], [-0.9, 0.0]], [0, 1]).infos
    assert infos[0]["invalid"]
    assert [*infos[0]["requirements"]] == [*infos[1]["requirements"]] == [*SCORES]


@pytest.mark.parametrize(("on_error", "margins"), [("fooled", 0.0), ("invalid", 1.0)])
def test_a_broken_world_fails_all_requirements_or_is_invalid(on_error, margins):
    broken = pole(on_error=on_error, valid=lambda _: "the physics exploded")
    outcomes = broken.evaluate([[0.0, 0.0]], [0])
    assert outcomes.score.tolist() == [margins]
    assert outcomes.infos[0]["requirements"] == dict.fromkeys(SCORES, margins)


def test_what_it_depends_on():
    assert pole().settings["score"]["calm"] == ["test_several:calm", 0.3]
    assert pole(requirement="up").settings["score"][0] == "up"
    assert pole(agent_id=None).fingerprint is None
    assert pole(score={"up": ("length", 9)}, fooling_threshold=0.5).fooling_threshold == EDGE


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"score": {}}, "Expected a score by name"),
        ({"score": {3: ("length", 9)}}, "texts as names of requirements, got 3"),
        ({"score": {"up": "down"}, "fooling_threshold": 0.5}, "Expected score to be"),
        (
            {"score": "down", "fooling_threshold": 0.5},
            "formula, signals, scale.*a dictionary of such",
        ),
        ({"fooling_threshold": {"up": 0.5}}, "Expected a threshold of 'calm'"),
        ({"fooling_threshold": THRESHOLDS | {"low": 0.1}}, "requirement in fooling_threshold"),
        ({"fooling_threshold": 1.0}, "fooling_threshold of 'up' to be a number from 0 to below 1"),
        ({"fooling_threshold": THRESHOLDS | {"calm": "a"}}, "of 'calm' to be a number"),
        ({"requirement": "safe"}, "'safe'"),
        ({"score": ("length", 500)}, "by name with several scores"),
        (
            {"score": ("length", 500), "fooling_threshold": 0.5, "requirement": "up"},
            "Expected requirement with several scores",
        ),
        (
            {
                "score": {"a": ("return", 0, 1), "b": ("return", 0, 1, 1)},
                "fooling_threshold": 0.5,
            },
            "requirements of one entry of the rewards",
        ),
    ],
)
def test_bad_requirements_are_told(changes, message):
    with pytest.raises(ValueError, match=message):
        pole(**changes)


def test_a_file_names_requirements(tmp_path):
    (tmp_path / "pole.py").write_text("def act(state):\n    return int(state[2] > 0)\n")
    (tmp_path / "pole.toml").write_text(
        """environment = "CartPole-v1"
agent = "pole:act"
agent_id = "by hand"
requirement = "up"
[parameters]
gravity = [5, 20.0]
[score]
up = ["length", 500]
earned = ["return", 0.0, 500.0]
[fooling_threshold]
up = 0.9
earned = 0.4
"""
    )
    application = read_application(tmp_path / "pole.toml")
    assert application.requirements == ("up", "earned")
    assert application.settings["score"] == [
        "up",
        {"up": [["length", 500], 0.9], "earned": [["return", 0.0, 500.0], 0.4]},
    ]


@pytest.mark.long
def test_the_diagnosis_and_the_gate_tell_them(tmp_path):
    application = pole()
    run = attack(application, "random", budget=60, samples=30, out=tmp_path / "run")
    told = [event.text for event in run.failures.behaviours.events]
    assert told
    assert all(text.startswith("fails ") for text in told)
    assert any(" and " in text for text in told)
    assert run.diagnosis is not None
    assert all("fails " in weakness.behaviour for weakness in run.diagnosis.weaknesses)
    counts, fooled = run.result.requirements, run.samples.fooled(EDGE)
    margins = [
        info["requirements"]
        for info in application.evaluate(run.samples.mu, run.samples.seed.tolist()).infos
    ]
    assert counts.worlds == sum(counts.together.values()) == fooled.sum()
    assert counts.each == {name: sum(one[name] <= EDGE for one in margins) for name in SCORES}
    alone = sum(one["up"] <= EDGE < min(one["calm"], one["earned"]) for one in margins)
    assert counts.together.get("up", 0) == alone
    text = dict(run.rows())["requirements"]
    line = f"up: length 100, fails where Q ≤ 0.9; broken in {counts.each['up']} of {fooled.sum()}"
    assert line in text
    page = run.html.read_text()
    assert line in page
    assert text.splitlines()[-1] in page
    export(run, tmp_path / "suite", application=application)
    result = regress(tmp_path / "suite", application)
    assert "fails " in result.failing
    single = pole(score=SCORES["up"], fooling_threshold=0.5)
    assert regress(tmp_path / "suite", single).failing is None
