"""How pilots are trained and measured, a few steps of it."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
import torch

from sada_gym import agents
from sada_gym.envs.uav.agent.network import light, new_network
from sada_gym.envs.uav.agent.pilot import WaypointPilot, as_pilot
from sada_gym.envs.uav.episodes import RacingEpisodes
from sada_gym.envs.uav.world.drone import SIMULATION_HZ
from sada_gym.envs.uav.world.track import GATES, TEMPLATES
from studies.training.imitation import Examples
from studies.training.uav import evaluate, train
from studies.training.uav.imitation import fit, gather, imitate, loss, strayed
from studies.training.uav.recipe import MILD, RECIPES
from studies.training.uav.reinforcement import reinforce

pytestmark = pytest.mark.slow  # goldens and reference sets guard what is shipped

TRY = replace(
    RECIPES["waypoint-pid"], lockstep=8, rounds=2, steps=320, epochs=1, last_epochs=1, batch=64
)
TRY_PPO = replace(RECIPES["ppo"], lockstep=2, steps=32, rollout=8, batch=8, epochs=1)


@pytest.fixture(scope="module")
def network():
    return new_network(0).eval()


@pytest.fixture
def impatient(monkeypatch):
    """A gate is missed after a fifth of a second: hardly trained pilots miss them all anyway."""
    monkeypatch.setattr("sada_gym.envs.uav.episodes._GATE_LIMIT", SIMULATION_HZ // 5)


def test_drones_stray_past_their_gate():
    races = RacingEpisodes([MILD.draw(np.random.default_rng(k)) for k in range(3)])
    assert not strayed(races).any()
    state = races.states[1].copy()
    x, y, _, heading = races.gates[1, races.next_gate[1]]
    state[:2] = x + 3 * np.cos(heading), y + 3 * np.sin(heading)
    races.place(1, state)
    assert strayed(races).tolist() == [False, True, False]


def test_a_round_gathers_what_it_should(network):
    gathered, rng = Examples(400), np.random.default_rng(0)
    gather(network, TRY, gathered, 1.0, rng)
    assert len(gathered) == TRY.steps
    gather(network, TRY, gathered, 0.0, rng)
    assert len(gathered) == 400
    observation, truth = gathered.batch(np.arange(400))
    images = light(observation["image"])
    assert images.shape == (400, 3, 48, 64)
    assert 0 <= float(images.min()) < float(images.max()) <= 1
    assert torch.isfinite(observation["motion"]).all()
    np.testing.assert_allclose(truth[:, 3:].norm(dim=1), 1, atol=1e-5)


def test_fitting_lowers_the_loss():
    rng, network = np.random.default_rng(0), new_network(0)
    gathered = Examples(TRY.steps)
    gather(network, TRY, gathered, 1.0, rng)
    first = fit(network, gathered, TRY, 1, rng)
    assert fit(network, gathered, TRY, 3, rng) < 0.7 * first


def test_near_errors_weigh_more():
    truth = torch.tensor([[0.1, 0, 0, 1, 0, 0], [1.0, 0, 0, 1, 0, 0]])
    answer = truth + torch.tensor([0.1, 0, 0, 0, 0, 0])
    assert loss(answer[:1], truth[:1]) > 2 * loss(answer[1:], truth[1:])


def test_training_is_repeatable():
    digests = {WaypointPilot(imitate(TRY, seed=3)).fingerprint for _ in range(2)}
    assert len(digests) == 1


def test_a_reinforcement_is_fixed_by_its_seed():
    first, again, other = (as_pilot(reinforce(TRY_PPO, seed=s)).fingerprint for s in (0, 0, 1))
    assert first == again != other


def test_a_reinforcement_moves_the_weights():
    before = reinforce(replace(TRY_PPO, rate=0.0), seed=0).policy.state_dict()
    after = reinforce(TRY_PPO, seed=0).policy.state_dict()
    assert not any(torch.equal(value, before[name]) for name, value in after.items())


@pytest.mark.parametrize(
    ("name", "recipe"),
    [("waypoint-pid", replace(TRY, steps=160)), ("ppo", replace(TRY_PPO, steps=16))],
)
@pytest.mark.usefixtures("impatient")
def test_the_script_writes_weights_and_a_card(name, recipe, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(train.RECIPES, name, recipe)
    monkeypatch.setattr(
        train,
        "measure",
        lambda pilot, seed: evaluate.measure(pilot, seed=seed, starts=1, mild=1, samples=2),
    )
    out = tmp_path / "new"
    arguments = ["train", name, "--seed", "4", "--out", str(out)]
    monkeypatch.setattr("sys.argv", arguments)
    train.main()
    file = out / f"{name}.safetensors"
    card = (out / f"{name}.md").read_text()
    trained = train.train(recipe, seed=4)
    assert as_pilot(agents.load(file, "SADA-UAV")).fingerprint == as_pilot(trained).fingerprint
    assert hashlib.sha256(file.read_bytes()).hexdigest() in card
    assert f"train {name} --seed 4 --out DIR" in card
    assert f"| steps | {recipe.steps} |" in card
    assert "--seed 1004" in card
    for anchors in TEMPLATES:
        assert f"| {anchors} | " in capsys.readouterr().out + card


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--steps", "40", "Expected --steps of at least 48, one for each of the recipe's drones"),
        ("--seed", "-1", "Expected --seed from 0 to 2147483647, got -1."),
        ("--seed", "2147483648", "Expected --seed from 0 to 2147483647, got 2147483648."),
    ],
)
def test_what_the_script_cannot_train_with_is_refused(
    option, value, message, tmp_path, monkeypatch, capsys
):
    out = tmp_path / "new"
    arguments = ["train", "waypoint-pid", f"{option}={value}", "--out", str(out)]
    monkeypatch.setattr("sys.argv", arguments)
    with pytest.raises(SystemExit, match="2"):
        train.main()
    assert message in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.usefixtures("impatient")
def test_a_measurement_counts_gates(network):
    figures = evaluate.measure(network, seed=0, starts=1, mild=2, samples=3)
    assert list(figures) == list(TEMPLATES)
    for f in figures.values():
        assert (f.template_gates, f.mild_gates, f.samples) == (GATES, 2 * GATES, 3)
        assert 0 <= f.template_passed <= GATES
        assert 0 <= f.mean_score <= 1
        assert 0 <= f.again <= f.fooled
        assert 0 <= f.near <= f.fooled


def test_the_recipes_train_on_tracks_milder_than_uniform_ones():
    assert set(RECIPES) == {"waypoint-pid", "ppo"}
    assert RECIPES["waypoint-pid"].distribution.spread == 0.25
    assert RECIPES["ppo"].distribution.spread == 0.5
    for recipe in RECIPES.values():
        assert recipe.distribution.anchors == tuple(TEMPLATES)
