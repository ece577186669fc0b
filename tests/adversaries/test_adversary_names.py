import subprocess
import sys

import pytest

from sada_gym import adversaries


def test_names_and_descriptions():
    assert adversaries.names() == [
        *("random", "archive", "gaussian", "gmm10", "gmm50", "svm", "gp", "bayesian"),
        *("bbgan", "bbgan-boost", "cross-entropy", "smc", "cma-mae", "sada"),
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
    assert adversaries.resolve("sada", {})["rounds"] == 4
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
        ("bbgan", {"generator": [64, "a"]}, r"Expected generator to be a list of ints"),
        ("bbgan-boost", {"copies": 0}, r"Expected copies to be an int from 1"),
        ("bbgan", {"stages": 2}, r"Expected the option of bbgan to be"),
        ("random", {"preset": "paper"}, r"Expected no preset with random, which has none"),
        ("missing_module:X", {}, r"Expected an adversary's name or module:Class.*missing_module"),
        ("sada_gym.evaluation.store:EvaluationStore", {}, r"to be a subclass of Adversary"),
    ],
)
def test_bad_names_and_options_are_refused(name, options, message):
    with pytest.raises(ValueError, match=message):
        adversaries.make(name, 2, **options)


def test_importing_the_registry_loads_no_torch():
    code = "import sys, sada_gym.adversaries as a; a.names(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
