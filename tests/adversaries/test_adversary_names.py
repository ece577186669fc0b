import subprocess
import sys
from dataclasses import fields

import pytest

from sada_gym import adversaries
from sada_gym.errors import UserError


def test_names_and_descriptions():
    assert adversaries.names() == [
        *("random", "memorise", "gaussian", "gmm10", "gmm50", "svm", "gp", "bayesian"),
        *("bbgan", "bbgan-boost", "cross-entropy", "smc", "cma-mae"),
        *("reinforce", "ppo", "sac", "td3", "trees", "level-set"),
    ]
    rows = {row.name: row for row in adversaries.describe()}
    assert list(rows) == adversaries.names()
    assert all(row.summary.endswith(".") for row in rows.values())
    assert rows["bbgan"].presets == ("default", "paper")
    assert rows["bbgan"].options["steps"] == 600
    assert rows["bbgan"].options["preset"] == "default"
    assert rows["random"].options == {}


def test_options_are_resolved_from_what_is_given_the_preset_and_the_defaults():
    default, paper = (
        adversaries.resolve("bbgan", {"preset": preset, "batch": 7})
        for preset in ("default", "paper")
    )
    assert default["batch"] == paper["batch"] == 7
    assert (default["induced_size"], paper["induced_size"]) == (0, 100)
    assert adversaries.resolve("level-set", {})["rounds"] == 4
    with pytest.raises(ValueError, match="preset to be one of default, paper"):
        adversaries.resolve("bbgan", {"preset": "papers"})


@pytest.mark.parametrize("name", adversaries.names())
def test_made_by_name(name):
    made = adversaries.make(name, dimension=3, seed=0)
    assert made.name == name
    assert made.dimension == 3


def test_ones_own_by_module_and_class():
    made = adversaries.make("sada_gym.adversaries.random:Random", 3, seed=0)
    assert (made.name, made.dimension) == ("random", 3)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("bbgann", {}, r"Expected the adversary to be one of random, .* Did you mean bbgan"),
        ("random", {"steps": 3}, r"Expected the option of random to be none; got 'steps'"),
        ("bbgan", {"step": 3}, r"Expected the option of bbgan to be .*; got 'step'.* mean steps"),
        ("bbgan", {"preset": "papers"}, r"preset to be one of default, paper.* mean paper"),
        ("bbgan", {"steps": "many"}, r"Expected steps to be an int from 1 to .*; got 'many'"),
        ("bbgan", {"steps": True}, r"Expected steps to be an int"),
        ("bbgan", {"dropout": 1.5}, r"Expected dropout to be a float from 0 to 0.95"),
        ("bbgan", {"beta1": float("nan")}, r"Expected beta1 to be a float"),
        (
            "bbgan",
            {"generator": [64, "a"]},
            "Expected generator to be a list of .*, each an int from 1",
        ),
        ("bbgan-boost", {"copies": 0}, r"Expected copies to be an int from 1"),
        ("bbgan", {"stages": 2}, r"Expected the option of bbgan to be"),
        ("random", {"preset": "paper"}, r"Expected no preset with random, which has none"),
        ("missing_module:X", {}, r"Expected an adversary's name or module:Class.*missing_module"),
        ("missing.:X", {}, "Expected an adversary's name or module:Class|raised"),
        (".relative:X", {}, "Expected to import '.relative' .* raised TypeError"),
        (":X", {}, "Expected to import '' .* raised ValueError"),
        ("sada_gym.evaluation.store:EvaluationStore", {}, r"to be a subclass of Adversary"),
    ],
)
def test_bad_names_and_options_are_refused(name, options, message):
    with pytest.raises(ValueError, match=message):
        adversaries.make(name, 2, **options)


@pytest.mark.parametrize(
    ("source", "raised"),
    [
        ("def broken(:", "SyntaxError"),
        ("raise KeyError('lost')", "KeyError: 'lost'"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        ("import lost_module", "No module named 'lost_module'"),
    ],
)
def test_a_module_that_cannot_be_imported_is_a_sentence(source, raised, tmp_path, monkeypatch):
    (tmp_path / "broken_adversary.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UserError, match=rf"Expected .*{raised}.*\."):
        adversaries.make("broken_adversary:Mine", 2)
    with pytest.raises(UserError, match=raised):
        adversaries.resolve("broken_adversary:Mine", {})


@pytest.mark.parametrize("dimension", [0, -1, 10**6, 2.0, "2"])
def test_a_bad_dimension_is_refused(dimension):
    with pytest.raises(UserError, match="Expected dimension "):
        adversaries.make("random", dimension)


@pytest.mark.parametrize("seed", [-1, 0.5, "1"])
def test_a_bad_seed_is_refused(seed):
    with pytest.raises(UserError, match="Expected seed "):
        adversaries.make("random", 2, seed=seed)


def test_every_number_among_the_options_has_limits():
    for name in adversaries.names():
        options = adversaries.find(name).options_class()
        for field in fields(options):
            if not isinstance(getattr(options, field.name), bool):
                rule = field.metadata["rule"]
                assert rule.choices or (rule.low is not None and rule.high is not None), field.name


def test_importing_the_registry_loads_no_torch():
    code = "import sys, sada_gym.adversaries as a; a.names(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
