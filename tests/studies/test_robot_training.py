import hashlib
import sys
from dataclasses import replace

import pytest

from sada_gym import agents
from sada_gym.agents.policy import as_policy
from sada_gym.envs.robot.agent import network
from sada_gym.envs.robot.episodes import RobotEpisodes
from studies.training.robot import train
from studies.training.robot.evaluate import measure, table
from studies.training.robot.recipe import RECIPES

pytestmark = pytest.mark.slow  # goldens and reference sets guard what is shipped

SHORT = replace(RECIPES["ppo-randomised"], lockstep=2, steps=32, rollout=8, batch=8, epochs=1)


def test_a_training_is_fixed_by_its_seed():
    first, again, other = (
        as_policy(train.train(SHORT, seed=s), RobotEpisodes).fingerprint for s in (0, 0, 1)
    )
    assert first == again != other


def test_a_trained_robot_is_saved_and_drives_again(tmp_path):
    model = train.train(SHORT, seed=0)
    network.save(model, tmp_path / "ppo.safetensors")
    again = agents.load(tmp_path / "ppo.safetensors", "SADA-Robot")
    assert (
        as_policy(again, RobotEpisodes).fingerprint == as_policy(model, RobotEpisodes).fingerprint
    )


def test_a_trial_of_the_script_writes_weights_and_no_card(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(RECIPES, "ppo", SHORT)
    monkeypatch.setattr(sys, "argv", ["train", "ppo", "--steps", "16", "--out", str(tmp_path)])
    train.main()
    assert [path.name for path in tmp_path.iterdir()] == ["ppo.safetensors"]
    assert "a trial's weights" in capsys.readouterr().out


def test_a_card_names_command_file_and_figures(tmp_path):
    file = tmp_path / "ppo.safetensors"
    file.write_bytes(b"weights")
    train.SCRIPT.write_card(file, RECIPES["ppo"], 3, 12.4, "| what |")
    text = (tmp_path / "ppo.md").read_text()
    for part in ("train ppo --seed 3 --out", "12 minutes", "evaluate ppo --seed 1003", "| what |"):
        assert part in " ".join(text.split())
    assert hashlib.sha256(b"weights").hexdigest() in text
    assert f"| steps | {RECIPES['ppo'].steps} |" in text


def test_the_shipped_robot_arrives_where_it_was_trained_for():
    """A small part of the model card's measurement; the card has 500 worlds of each kind."""
    figures = measure(agents.load("ppo", "SADA-Robot"), seed=5, worlds=40, referenced=5)
    assert figures.nominal > 0.95 * 400
    assert figures.mild > 0.9 * 400
    assert 0.2 * 40 < figures.fooled < 0.7 * 40  # the card's 44 %, four standard errors
    assert "privileged driver" in table(figures)
