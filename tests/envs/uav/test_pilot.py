import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from scipy.spatial.transform import Rotation

from sada_gym import agents
from sada_gym.agents.imitation import Examples
from sada_gym.envs.uav.agent import evaluate, train, weights
from sada_gym.envs.uav.agent.drone_frame import in_drone, in_level, motion
from sada_gym.envs.uav.agent.imitation import fit, gather, imitate, loss, strayed
from sada_gym.envs.uav.agent.network import light, new_network
from sada_gym.envs.uav.agent.pilot import WAYPOINT_TILE, WaypointPilot, as_pilot
from sada_gym.envs.uav.agent.recipe import MILD, RECIPES
from sada_gym.envs.uav.agent.reinforcement import reinforce
from sada_gym.envs.uav.episodes import Races
from sada_gym.envs.uav.world.drone import SIMULATION_HZ
from sada_gym.envs.uav.world.guidance import waypoints
from sada_gym.envs.uav.world.templates import TEMPLATES
from sada_gym.envs.uav.world.track import GATES

TRY = replace(
    RECIPES["waypoint-pid"], lockstep=8, rounds=2, steps=320, epochs=1, last_epochs=1, batch=64
)
TRY_PPO = replace(RECIPES["ppo"], lockstep=2, steps=32, rollout=8, batch=8, epochs=1)


@pytest.fixture
def poses():
    rng = np.random.default_rng(0)
    angles = rng.uniform([-3, -1, -1], [3, 1, 1], (50, 3))
    turns = Rotation.from_euler("ZYX", angles).as_quat()
    return np.hstack([rng.normal(0, 5, (50, 3)), turns, rng.normal(0, 5, (50, 6))])


@pytest.fixture
def gates():
    return np.random.default_rng(1).uniform([-20, -20, 1, -3], [20, 20, 3, 3], (50, GATES, 4))


@pytest.fixture(scope="module")
def network():
    return new_network(0).eval()


@pytest.fixture
def impatient(monkeypatch):
    """A gate is missed after a fifth of a second: hardly trained pilots miss them all anyway."""
    monkeypatch.setattr("sada_gym.envs.uav.episodes._GATE_LIMIT", SIMULATION_HZ // 5)


def test_a_drones_motion_is_in_its_own_frame(poses):
    own = Rotation.from_quat(poses[:, 3:7]).inv()
    motions = motion(poses)
    np.testing.assert_allclose(motions[:, :3], own.apply([0, 0, 1]), atol=1e-6)
    np.testing.assert_allclose(motions[:, 3:6], own.apply(poses[:, 7:10]) / 10, atol=1e-6)
    np.testing.assert_allclose(motions[:, 6:], own.apply(poses[:, 10:]) / 5, atol=1e-6)


def test_waypoints_survive_the_way_through_the_drones_frame(poses, gates):
    true = waypoints(gates[:, 0], poses)
    back = in_level(poses, in_drone(poses, true))
    back[:, 3] = true[:, 3] + (back[:, 3] - true[:, 3] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(back, true, atol=1e-4)


def test_answers_are_where_the_gate_is(poses, gates):
    answers = in_drone(poses, waypoints(gates[:, 0], poses))
    turn = Rotation.from_quat(poses[:, 3:7])
    places = poses[:, :3] + 10 * turn.apply(answers[:, :3])
    np.testing.assert_allclose(places, gates[:, 0, :3], atol=1e-4)
    ahead = turn.apply(answers[:, 3:])
    np.testing.assert_allclose(ahead[:, 0], np.cos(gates[:, 0, 3]), atol=1e-6)
    np.testing.assert_allclose(ahead[:, 2], 0, atol=1e-6)


def test_a_waypoint_does_not_depend_on_the_others_in_the_batch(network, poses, gates):
    pilot, seeds = WaypointPilot(network), np.arange(50)
    together = pilot.waypoints(gates, poses, seeds)
    for rows in ([0], [7], list(range(3, 3 + WAYPOINT_TILE)), [49, 2, 17], list(range(49, -1, -1))):
        some = pilot.waypoints(gates[rows], poses[rows], seeds[rows])
        np.testing.assert_array_equal(some, together[rows])


def test_no_drone_sees_nothing(network, poses, gates):
    none = np.arange(0)
    assert WaypointPilot(network).waypoints(gates[none], poses[none], none).shape == (0, 4)


def test_a_seed_fixes_the_weights_and_leaves_the_global_generators_alone():
    before = torch.get_rng_state()
    one, same, other = (WaypointPilot(new_network(seed)) for seed in (1, 1, 2))
    assert torch.equal(torch.get_rng_state(), before)
    assert one.fingerprint == same.fingerprint != other.fingerprint


def test_drones_stray_past_their_gate():
    races = Races([MILD.draw(np.random.default_rng(k)) for k in range(3)])
    assert not strayed(races).any()
    state = races.states[1].copy()
    x, y, _, heading = races.gates[1, races.next_gate[1]]
    state[:2] = x + 3 * np.cos(heading), y + 3 * np.sin(heading)
    races.place(1, state)
    assert strayed(races).tolist() == [False, True, False]
    races.close()


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


def test_weights_survive_a_file(tmp_path, network):
    path = tmp_path / "pilot.safetensors"
    weights.save(network, path)
    loaded = agents.load(str(path), "SADA-UAV")
    assert WaypointPilot(loaded).fingerprint == WaypointPilot(network).fingerprint


def test_a_missing_or_foreign_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no such file"):
        agents.load(tmp_path / "none.safetensors", "SADA-UAV")
    path = tmp_path / "text.safetensors"
    path.write_text("weights")
    with pytest.raises(ValueError, match="Expected the weights of a pilot"):
        agents.load(path, "SADA-UAV")
    with pytest.raises(ValueError, match="Expected an agent's name"):
        agents.load("nobody", "SADA-UAV")


@pytest.mark.parametrize("kind", [str, Path])
def test_sb3s_files_are_refused_with_the_reason(kind):
    message = r"among waypoint-pid, ppo, or a \.safetensors file, got the file mine\.zip\. SB3's"
    with pytest.raises(ValueError, match=rf"{message}.*pickles.*agent=PPO\.load\(file\)"):
        agents.load(kind("mine.zip"), "SADA-UAV")


def _without(found):
    del found["head.0.bias"]


def _wider(found):
    found["seen.0.weight"] = torch.zeros(256, 768)


def _another(found):
    found["memory.weight"] = torch.zeros(3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_without, r"head\.0\.bias of shape \(64,\), got no head\.0\.bias\."),
        (_wider, r"seen\.0\.weight of shape \(128, 768\), got \(256, 768\)\."),
        (_another, r"without memory\.weight, got one\."),
    ],
)
def test_weights_that_do_not_fit_are_named(tmp_path, change, message):
    found = load_file(agents.card("waypoint-pid").path)
    change(found)
    save_file(found, tmp_path / "big.safetensors")
    with pytest.raises(ValueError, match=f"{message} Write such a file") as caught:
        agents.load(str(tmp_path / "big.safetensors"), "SADA-UAV")
    assert "\n" not in str(caught.value)


def test_a_detectors_file_is_no_pilots():
    with pytest.raises(ValueError, match=r"like ppo in .*: .*, got no .*pass the model as agent="):
        agents.load(agents.card("photographer").path, "SADA-UAV")


@pytest.mark.parametrize(
    ("name", "recipe", "steps"), [("waypoint-pid", TRY, "160"), ("ppo", TRY_PPO, "16")]
)
@pytest.mark.usefixtures("impatient")
def test_the_script_writes_weights_and_a_card(name, recipe, steps, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(train, "RECIPES", {name: recipe})
    monkeypatch.setattr(
        train,
        "measure",
        lambda pilot, seed: evaluate.measure(pilot, seed=seed, starts=1, mild=1, samples=2),
    )
    out = tmp_path / "new"
    arguments = ["train", name, "--seed", "4", "--steps", steps, "--out", str(out)]
    monkeypatch.setattr("sys.argv", arguments)
    train.main()
    file = out / f"{name}.safetensors"
    card = (out / f"{name}.md").read_text()
    trained = train.train(replace(recipe, steps=int(steps)), seed=4)
    assert as_pilot(agents.load(file, "SADA-UAV")).fingerprint == as_pilot(trained).fingerprint
    assert hashlib.sha256(file.read_bytes()).hexdigest() in card
    assert f"train {name} --seed 4 --steps {steps} --out DIR" in card
    assert f"| steps | {steps} |" in card
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


def test_the_recipes_train_on_mild_tracks_alone():
    assert set(RECIPES) == {"waypoint-pid", "ppo"}
    for recipe in RECIPES.values():
        assert recipe.course.spread == 0.25
        assert recipe.course.anchors == tuple(TEMPLATES)
