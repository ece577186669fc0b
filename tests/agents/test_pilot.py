import hashlib

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from sada_gym import agents
from sada_gym.agents.pilot import evaluate, train, weights
from sada_gym.agents.pilot.imitation import Gathered, fit, gather, imitate, loss, strayed
from sada_gym.agents.pilot.network import new_network
from sada_gym.agents.pilot.recipe import MILD, RECIPES, Imitation
from sada_gym.envs.uav.guidance import waypoints
from sada_gym.envs.uav.pilot import TILE, WaypointPilot, in_drone, in_level, motion
from sada_gym.envs.uav.races import Races
from sada_gym.envs.uav.templates import TEMPLATES
from sada_gym.envs.uav.track import GATES

TRY = Imitation(drones=8, rounds=2, steps=320, epochs=1, last_epochs=1, batch=64)


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


def test_what_a_drone_feels_is_in_its_own_frame(poses):
    own = Rotation.from_quat(poses[:, 3:7]).inv()
    felt = motion(poses)
    np.testing.assert_allclose(felt[:, :3], own.apply([0, 0, 1]), atol=1e-6)
    np.testing.assert_allclose(felt[:, 3:6], own.apply(poses[:, 7:10]) / 10, atol=1e-6)
    np.testing.assert_allclose(felt[:, 6:], own.apply(poses[:, 10:]) / 5, atol=1e-6)


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
    pilot, looks = WaypointPilot(network), np.arange(50)
    together = pilot.waypoints(gates, poses, looks)
    for rows in ([0], [7], list(range(3, 3 + TILE)), [49, 2, 17], list(range(49, -1, -1))):
        some = pilot.waypoints(gates[rows], poses[rows], looks[rows])
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
    gathered, rng = Gathered(400), np.random.default_rng(0)
    gather(network, TRY, gathered, 1.0, rng)
    assert len(gathered) == TRY.steps
    gather(network, TRY, gathered, 0.0, rng)
    assert len(gathered) == 400
    light, felt, truth = gathered.batch(np.arange(400))
    assert light.shape == (400, 3, 48, 64)
    assert 0 <= float(light.min()) < float(light.max()) <= 1
    assert torch.isfinite(felt).all()
    np.testing.assert_allclose(truth[:, 3:].norm(dim=1), 1, atol=1e-5)


def test_fitting_lowers_the_loss():
    rng, network = np.random.default_rng(0), new_network(0)
    gathered = Gathered(TRY.steps)
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


def test_weights_survive_a_file(tmp_path, network):
    path = tmp_path / "pilot.safetensors"
    weights.save(network, path)
    loaded = agents.load_pilot(str(path))
    assert WaypointPilot(loaded).fingerprint == WaypointPilot(network).fingerprint


def test_a_missing_or_foreign_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no such file"):
        agents.load_pilot(tmp_path / "none.safetensors")
    path = tmp_path / "text.safetensors"
    path.write_text("weights")
    with pytest.raises(ValueError, match="Expected the weights of a pilot"):
        agents.load_pilot(path)
    with pytest.raises(ValueError, match="Expected an agent's name"):
        agents.load_pilot("nobody")


def test_the_script_writes_weights_and_a_card(tmp_path, monkeypatch, capsys):
    recipes = {"waypoint-pid": TRY}
    monkeypatch.setattr(train, "RECIPES", recipes)
    monkeypatch.setattr(
        train,
        "measure",
        lambda pilot, seed: evaluate.measure(pilot, seed=seed, looks=1, mild=1, samples=2),
    )
    out = tmp_path / "new"
    arguments = ["train", "waypoint-pid", "--seed", "4", "--steps", "160", "--out", str(out)]
    monkeypatch.setattr("sys.argv", arguments)
    train.main()
    file = out / "waypoint-pid.safetensors"
    card = (out / "waypoint-pid.md").read_text()
    assert hashlib.sha256(file.read_bytes()).hexdigest() in card
    assert "--seed 4 --steps 160 --out DIR" in card
    assert "| steps | 160 |" in card
    assert "--seed 1004" in card
    for anchors in TEMPLATES:
        assert f"| {anchors} | " in capsys.readouterr().out + card


def test_a_measurement_counts_gates(network):
    figures = evaluate.measure(network, seed=0, looks=1, mild=2, samples=3)
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
