from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from scipy.spatial.transform import Rotation

from sada_gym import agents
from sada_gym.envs.uav.agent import network as files
from sada_gym.envs.uav.agent.network import new_network
from sada_gym.envs.uav.agent.pilot import WAYPOINT_TILE, WaypointPilot, in_level, motion
from sada_gym.envs.uav.world.guidance import waypoints
from sada_gym.envs.uav.world.track import GATES
from studies.training.uav.answers import in_drone


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
    first, same, other = (WaypointPilot(new_network(seed)) for seed in (1, 1, 2))
    assert torch.equal(torch.get_rng_state(), before)
    assert first.fingerprint == same.fingerprint != other.fingerprint


def test_weights_survive_a_file(tmp_path, network):
    path = tmp_path / "pilot.safetensors"
    files.save(network, path)
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
    message = r"among ppo, waypoint-pid, or a \.safetensors file, got the file mine\.zip\. SB3's"
    with pytest.raises(ValueError, match=rf"{message}.*pickles.*agent=PPO\.load\(file\)"):
        agents.load(kind("mine.zip"), "SADA-UAV")


def _without(arrays):
    del arrays["head.0.bias"]


def _wider(arrays):
    arrays["seen.0.weight"] = torch.zeros(256, 768)


def _another(arrays):
    arrays["memory.weight"] = torch.zeros(3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_without, r"head\.0\.bias of shape \(64,\), got no head\.0\.bias\."),
        (_wider, r"seen\.0\.weight of shape \(128, 768\), got \(256, 768\)\."),
        (_another, r"without memory\.weight, got one\."),
    ],
)
def test_weights_that_do_not_fit_are_named(tmp_path, change, message):
    arrays = load_file(agents.card("waypoint-pid").path)
    change(arrays)
    save_file(arrays, tmp_path / "big.safetensors")
    with pytest.raises(ValueError, match=f"{message} Write such a file") as caught:
        agents.load(str(tmp_path / "big.safetensors"), "SADA-UAV")
    assert "\n" not in str(caught.value)


def test_a_detectors_file_is_no_pilots():
    with pytest.raises(ValueError, match=r"like ppo in .*: .*, got no .*pass the model as agent="):
        agents.load(agents.card("photographer").path, "SADA-UAV")
