import hashlib
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from drivers import as_driver

from sada_gym import agents
from sada_gym.envs.driving.agent import network
from studies.training.common import Reinforcement
from studies.training.driving import evaluate, train
from studies.training.driving.evaluate import TaskFigures, measure, table
from studies.training.driving.recipe import RECIPES

pytestmark = pytest.mark.slow  # goldens and reference sets guard what is shipped

SHORT = replace(RECIPES["cil"], lockstep=4, rounds=2, steps=16, epochs=1, last_epochs=1, batch=8)
SHORTER = replace(
    RECIPES["ppo"],
    initial_agent=None,
    lockstep=2,
    steps=32,
    value_steps=0,
    rollout=8,
    batch=8,
    epochs=1,
)


@pytest.mark.parametrize("recipe", [SHORT, SHORTER], ids=["imitation", "reinforcement"])
def test_a_training_is_fixed_by_its_seed(recipe):
    first, again, other = (as_driver(train.train(recipe, seed=s)).fingerprint for s in (0, 0, 1))
    assert first == again != other


@pytest.mark.parametrize("recipe", [SHORT, SHORTER], ids=["imitation", "reinforcement"])
def test_a_training_moves_the_weights_that_it_is_to_move(recipe):
    before = train.train(replace(recipe, rate=0.0), seed=0).policy.state_dict()
    after = train.train(recipe, seed=0).policy.state_dict()
    moved = {name for name, value in after.items() if not torch.equal(value, before[name])}
    assert {"action_net.weight", "features_extractor.convolutions.0.weight"} <= moved
    assert ("log_std" in moved) == isinstance(recipe, Reinforcement)


def test_a_warm_start_keeps_the_driver_until_values_are_known():
    shipped = agents.load("cil", "SADA-Driving").policy.state_dict()
    warm = replace(SHORTER, initial_agent="cil", value_steps=100)
    kept = train.train(warm, seed=0).policy.state_dict()
    changed = train.train(replace(warm, value_steps=16, steps=64), seed=0).policy.state_dict()
    name = "features_extractor.convolutions.0.weight"
    assert torch.equal(kept[name], shipped[name])
    assert not torch.equal(kept["value_net.weight"], shipped["value_net.weight"])
    assert not torch.equal(changed[name], shipped[name])


def test_a_trained_driver_is_saved_and_driven_again(tmp_path):
    model = train.train(SHORTER, seed=0)  # its learning rate falls: a schedule is saved as well
    network.save(model, tmp_path / "ppo.safetensors")
    again = agents.load(tmp_path / "ppo.safetensors", "SADA-Driving")
    assert as_driver(again).fingerprint == as_driver(model).fingerprint


def test_a_trial_of_the_script_writes_weights_and_no_card(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(RECIPES, "cil", SHORT)
    monkeypatch.setattr(sys, "argv", ["train", "cil", "--steps", "8", "--out", str(tmp_path)])
    train.main()
    assert [path.name for path in tmp_path.iterdir()] == ["cil.safetensors"]
    assert "a trial's weights" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--steps", "63", "Expected --steps of at least 64, one for each of the recipe's cars"),
        ("--seed", "-1", "Expected --seed from 0 to 2147483647, got -1."),
    ],
)
def test_what_the_script_cannot_train_with_is_refused(
    option, value, message, tmp_path, monkeypatch, capsys
):
    arguments = ["train", "cil", f"{option}={value}", "--out", str(tmp_path / "new")]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit, match="2"):
        train.main()
    assert message in capsys.readouterr().err


def test_the_script_never_writes_into_the_package_unasked(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["train", "cil"])
    with pytest.raises(SystemExit):
        train.main()
    assert "--out" in capsys.readouterr().err


def test_a_card_names_command_file_and_figures(tmp_path):
    weights = tmp_path / "cil.safetensors"
    weights.write_bytes(b"weights")
    train.SCRIPT.write_card(weights, RECIPES["cil"], 3, 12.4, "| task |")
    text = (tmp_path / "cil.md").read_text()
    for part in ("train cil --seed 3 --out", "12 minutes", "evaluate cil --seed 1003", "| task |"):
        assert part in text
    assert hashlib.sha256(b"weights").hexdigest() in text
    assert f"| rounds | {RECIPES['cil'].rounds} |" in text


def test_the_shipped_driver_arrives_where_it_was_trained_for():
    """A small part of the model card's measurement; the card has ten starts a weather."""
    figures = measure(agents.load("cil", "SADA-Driving"), seed=5, starts=1, samples=1)
    assert {task: (f.runs, f.arrived) for task, f in figures.items()} == dict.fromkeys(
        ("straight", "one_curve", "navigation"), (20, 20)
    )
    assert all(f.unseen_runs == 10 and f.samples == 1 for f in figures.values())


def test_figures_are_written_as_a_table():
    text = table({"straight": TaskFigures(200, 199, 100, 98, 500, 50, 0.875)})
    row = "| straight | 199 of 200 | 98 of 100 | 0.88 | 10.0 % (7.7 to 12.9) |"
    assert text.splitlines()[-1] == row


def test_a_driver_is_measured_by_name_or_file(tmp_path, monkeypatch, capsys):
    seen = []
    monkeypatch.setattr(evaluate, "measure", lambda driver, seed: seen.append((driver, seed)) or {})
    network.save(train.train(SHORTER, seed=0), tmp_path / "own.safetensors")
    for name in ("cil", str(tmp_path / "own.safetensors")):
        monkeypatch.setattr(sys, "argv", ["evaluate", name, "--seed", "4"])
        before = np.random.get_state()[1].copy()  # noqa: NPY002
        evaluate.main()
        np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002
    assert [seed for _, seed in seen] == [4, 4]
    assert "| task |" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["evaluate", "moon"])
    with pytest.raises(SystemExit, match="2"):
        evaluate.main()
    assert "an agent's name among cil" in capsys.readouterr().err
