"""Attacks in CARLA: on a server within this process, over CARLA's own types."""

from __future__ import annotations

import json
import os
import pickle
import socket
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

carla = pytest.importorskip(
    "carla", reason="Expected CARLA's client. Install it: pip install '.[carla]'"
)
import fake_carla  # noqa: E402
from fake_carla import lane_driver  # noqa: E402

from sada_gym import attack  # noqa: E402
from sada_gym.envs.carla import application as application_module  # noqa: E402
from sada_gym.envs.carla import drive as drive_module  # noqa: E402
from sada_gym.envs.carla import routes  # noqa: E402
from sada_gym.envs.carla.application import CarlaDrivingApplication  # noqa: E402
from sada_gym.envs.carla.connection import Servers  # noqa: E402
from sada_gym.envs.carla.routes import COMMANDS, find_routes  # noqa: E402
from sada_gym.errors import ServerLost, UserError  # noqa: E402
from sada_gym.evaluation.executors import Workers  # noqa: E402
from sada_gym.evaluation.problems import make_application  # noqa: E402

ID = "SADA-DrivingCarla-v0"
SUPPORT = Path(fake_carla.__file__).parent


@pytest.fixture
def start(monkeypatch):
    """Start fake servers that are gone after the test."""
    monkeypatch.setattr(carla, "Client", fake_carla.Client)
    monkeypatch.setattr(fake_carla, "SERVERS", {})
    monkeypatch.setattr(drive_module, "_FRAME_S", 0.01)
    monkeypatch.delenv("SADA_CARLA_HOST", raising=False)
    return fake_carla.start


@pytest.fixture
def one_route(monkeypatch):
    """Drive one route of a town; five take as many times as long."""
    for module in (routes, application_module):
        monkeypatch.setattr(module, "ROUTES", 1)


def driven(**keywords):
    agent = {"agent": lane_driver, "agent_id": "lanes", "episodes": 1, "task": "one_curve"}
    return CarlaDrivingApplication(**{**agent, **keywords})


def assert_left_as_found(server):
    assert server.actors == []
    assert server.settings == carla.WorldSettings()
    assert not server.traffic_synchronous
    assert server.weather == carla.WeatherParameters.CloudyNoon


def test_mount_and_weather_decide_who_arrives(start):
    server = start()
    application = driven()
    nominal, high, dark = (
        application.parameters.normalised(world)
        for world in ([1.4, -15, 0.5], [2.0, -10, 0.5], [1.4, -15, 5.5])
    )
    np.testing.assert_array_equal(application.nominal, nominal)
    outcomes = application.evaluate([nominal, high, dark], [0, 1, 2])
    assert outcomes.score.tolist() == [1.0, 0.0, 0.0]
    assert [info["weather"] for info in outcomes.infos] == ["ClearNoon"] * 2 + ["SoftRainSunset"]
    assert outcomes.infos[0]["endings"] == ["arrived"] * 5
    assert outcomes.infos[1]["endings"] == ["left_route"] * 5
    assert (outcomes.infos[1]["progress"] < 1.0).all()
    assert server.worlds == 3
    assert_left_as_found(server)


def test_each_parameter_of_the_continuous_weather_reaches_the_server(start, monkeypatch):
    start()
    application = driven(weather="continuous", task="straight")
    seen = []
    set_weather = fake_carla.World.set_weather
    monkeypatch.setattr(
        fake_carla.World, "set_weather", lambda *a: (seen.append(a[1]), set_weather(*a))
    )
    application.render([0, 0, -0.5, 0.0, -0.8, 0.5], 0)
    weather = seen[0]
    told = (weather.fog_density, weather.precipitation, weather.sun_altitude_angle, weather.wetness)
    assert told == pytest.approx((25.0, 50.0, 0.0, 75.0), abs=1e-4)
    assert weather.rayleigh_scattering_scale == pytest.approx(0.0331)
    assert application.evaluate([application.nominal], [0]).score == 1.0


def test_episodes_have_seeds_of_their_own_and_are_averaged(start):
    server = start()
    outcomes = driven(episodes=2, task="straight").evaluate([[0.0, 0.0, -0.9]], [7])
    assert len(outcomes.infos[0]["endings"]) == 10
    pedestrians = [seed for kind, seed in server.seeds if kind == "pedestrians"]
    assert pedestrians == [seed for kind, seed in server.seeds if kind == "traffic"]
    assert len(set(pedestrians)) == 2


@pytest.mark.parametrize("task", ["straight", "one_curve", "navigation"])
def test_routes_do_what_their_task_says(task):
    found, again = (find_routes(fake_carla.town(), task) for _ in range(2))
    assert [route.start for route in found] == [route.start for route in again]
    assert len({route.start for route in found}) == 5
    for route in found:
        steps = np.hypot(*np.diff(route.points_m, axis=0).T)
        assert steps.max() < 3.0
        told = [COMMANDS[code] for code in route.commands]
        junctions = [a for a, b in zip(told, ["", *told], strict=False) if a not in ("follow", b)]
        turns = [one for one in junctions if one != "straight"]
        assert len(turns) == {"straight": 0, "one_curve": 1, "navigation": 2}[task], junctions
        assert told[0] == told[-1] == "follow"


def test_the_autopilot_is_the_privileged_driver(start):
    start()
    application = driven(task="navigation")
    worst = application.parameters.normalised([2.0, -10.0, 5.5])
    assert application.privileged_score([worst], [0]) == 1.0
    env = gym.make(ID, episodes=1, task="straight")  # drives by the autopilot
    env.reset(seed=0)
    assert env.step(np.zeros(3, np.float32))[1] == -1.0


class Cil(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.throttle = torch.nn.Parameter(torch.tensor(0.4))
        self.seen = []

    def forward(self, image, speed, command):
        self.seen.append((image.shape, float(image.max()), speed.shape, int(command)))
        return torch.zeros(1, 1), self.throttle.reshape(1, 1), torch.zeros(1, 1)


def test_a_torch_module_drives_by_the_convention_of_imitation_learning(start):
    start()
    module = Cil()
    application = driven(agent=module, agent_id=None, task="straight")
    assert application.fingerprint
    assert application.evaluate([[0, 0, -0.9]], [0]).score == 1.0
    assert {shapes[0] for shapes in module.seen} == {(1, 3, 88, 200)}
    assert {shapes[3] for shapes in module.seen} == {2, 5}
    assert max(shapes[1] for shapes in module.seen) <= 1.0


@pytest.mark.usefixtures("one_route")
def test_an_sb3_zip_drives(start, tmp_path, monkeypatch):
    from stable_baselines3 import PPO

    class Spaces(gym.Env):
        observation_space = drive_module.OBSERVATION_SPACE
        action_space = drive_module.ACTION_SPACE

    PPO("MultiInputPolicy", Spaces(), n_steps=8, batch_size=8).save(tmp_path / "my driver.zip")
    start()
    monkeypatch.setattr(drive_module, "_SLOWEST_M_S", 40.0)  # the network is slow, the end near
    application = driven(agent=str(tmp_path / "my driver.zip"), agent_id=None)
    assert len(application.fingerprint) == 64
    assert application.evaluate([[0, 0, 0]], [0]).score[0] <= 1.0


def test_replay_shows_the_drives_and_render_the_first_picture(start):
    server = start()
    application = driven(task="straight")
    assert application.render([0, 0, -0.9], 0).shape == (264, 600, 3)
    frames, score = application.replay([0, 0, -0.9], 0)
    assert score == 1.0
    assert len(frames) > 100
    assert {frame.shape for frame in frames} == {(88, 200, 3)}
    assert_left_as_found(server)


@pytest.mark.long
def test_no_server_is_told_in_under_five_seconds():
    with socket.socket() as reserved:
        reserved.bind(("127.0.0.1", 0))
        port = min(reserved.getsockname()[1], 59_535)
    application = CarlaDrivingApplication(host=f"127.0.0.1:{port}")
    began = time.monotonic()
    with pytest.raises(UserError, match=f"Expected a CARLA server at 127.0.0.1:{port}, got no a"):
        application.evaluate([[0, 0, 0]], [0])
    assert time.monotonic() - began < 5.0


def test_another_version_is_told_before_anything_is_changed(start):
    server = start(version="0.9.15-12-gabc")
    with pytest.raises(UserError, match=r"version 0.9.16 .* got 0.9.15-12.*install carla==0.9.15,"):
        driven().evaluate([[0, 0, 0]], [0])
    assert server.worlds == server.ticks == 0


def test_an_unknown_town_is_told_with_those_there_are(start):
    server = start()
    with pytest.raises(UserError, match="one of Town01, Town10HD_Opt; got 'Town99'"):
        driven(town="Town99").evaluate([[0, 0, 0]], [0])
    assert server.worlds == 0


@pytest.mark.parametrize(
    ("faults", "reason"),
    [
        ({"refuses_spawns": True}, "the server refused a car"),
        ({"drops_every": 1}, "the camera lost more than 10 frames"),
    ],
)
def test_what_the_server_cannot_compute_is_invalid_and_no_failure(start, faults, reason):
    server = start(**faults)
    outcomes = driven().evaluate([[0, 0, 0]], [0])
    assert reason in outcomes.invalid[0]
    assert not outcomes.fooled[0]
    assert_left_as_found(server)


def test_a_few_lost_frames_do_no_harm(start):
    server = start(drops_every=60)
    outcomes = driven(task="straight").evaluate([[0, 0, -0.9]], [0])
    assert outcomes.score == 1.0
    assert not outcomes.invalid
    assert_left_as_found(server)


def test_a_server_that_dies_is_told(start):
    start(dies_at_tick=50)
    with pytest.raises(ServerLost, match=r"server at localhost:2000 to go on, got .*--resume"):
        driven().evaluate([[0, 0, 0]], [0])


def test_ctrl_c_and_a_raising_driver_leave_nothing(start):
    server = start(interrupts_at_tick=100)
    with pytest.raises(KeyboardInterrupt):
        driven().evaluate([[0, 0, 0]], [0])
    assert_left_as_found(server)
    with pytest.raises(UserError, match="ZeroDivisionError"):
        driven(agent=lambda observation: 1 / 0).evaluate([[0, 0, 0]], [0])
    assert_left_as_found(server)
    with pytest.raises(UserError, match=r"Expected \(steer, acceleration\)"):
        driven(agent=lambda observation: [np.nan, 0.0]).evaluate([[0, 0, 0]], [0])
    assert_left_as_found(server)


def test_what_a_killed_run_left_is_cleared(start):
    server = start()
    server.settings.synchronous_mode, server.settings.fixed_delta_seconds = True, 0.05
    driven().render([0, 0, 0], 0)
    assert_left_as_found(server)


def test_another_users_settings_come_back(start):
    server = start()
    server.settings.no_rendering_mode, server.settings.fixed_delta_seconds = True, 0.02
    driven().render([0, 0, 0], 0)
    assert server.settings.no_rendering_mode
    assert server.settings.fixed_delta_seconds == pytest.approx(0.02)


def test_a_server_in_use_is_left_to_its_user(start):
    from sada_gym.envs.carla.connection import session

    first, second = start(2000), start(2010)
    servers = Servers.named("localhost:2000,2010")
    with session(servers, "Town01") as one, session(servers, "Town01") as other:
        assert (one.place, other.place) == ("localhost:2000", "localhost:2010")
        assert first.settings.synchronous_mode
        assert second.settings.synchronous_mode
    assert_left_as_found(first)
    assert_left_as_found(second)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"host": "localhost:port"}, "Expected the host and ports"),
        ({"host": "localhost:99999"}, "Expected the host and ports up to 59535"),
        ({"host": "http://localhost"}, "Expected the host and ports"),
        ({"host": 2000}, "Expected host='localhost:2000', say, got 2000"),
        ({"task": "stright"}, "Did you mean straight"),
        ({"weather": "sunny"}, "Expected the weather to be one of presets, continuous"),
        ({"episodes": 0}, "Expected episodes of at least 1"),
        ({"town": 1}, "Expected a town's name"),
        ({"agent": "no such.zip"}, "no such file"),
        ({"agent": 5}, "Expected an SB3 model"),
        ({"agent_id": 5}, "Expected agent_id in one line"),
    ],
)
def test_bad_keywords_are_told(keywords, message):
    with pytest.raises(UserError, match=message):
        CarlaDrivingApplication(**keywords)


def test_the_variable_names_the_server(monkeypatch):
    monkeypatch.setenv("SADA_CARLA_HOST", "10.0.0.5:3000")
    assert Servers.named(None) == Servers("10.0.0.5", (3000,))
    assert "host" not in make_application(ID).settings
    assert pickle.loads(pickle.dumps(make_application(ID))).servers.ports == (3000,)


ATTACK = {"budget": 40, "samples": 4, "progress": False, "pictures": False}


def stored(run):
    with closing(sqlite3.connect(run / "run.sqlite")) as store:
        return store.execute("SELECT COUNT(*) FROM evaluation").fetchone()[0]


CODE = """
import json, sys
from fake_carla import lane_driver
from sada_gym import Workers, attack
from sada_gym.envs.carla.application import CarlaDrivingApplication

if __name__ == "__main__":
    run, host, options = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
    application = CarlaDrivingApplication(
        "one_curve", agent=lane_driver, agent_id="lanes", episodes=1, host=host
    )
    workers = Workers(options.pop("workers", 1), chunk_size=4)
    attack(application, "level-set", out=run, workers=workers, **options)
"""
"""The script of an attack: the run's folder, the servers and the options are its arguments."""


def attack_elsewhere(run, host="localhost:2000", workers=None, **told):
    """Attack in a process of its own, with one route, and return its exit code and errors."""
    options = ATTACK | ({} if workers is None else {"workers": workers})
    script = run.parent / f"{run.name}.py"
    script.write_text(CODE, encoding="utf-8")
    paths = [str(SUPPORT), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    done = subprocess.run(
        [sys.executable, str(script), str(run), host, json.dumps(options)],
        env=os.environ
        | {"FAKE_CARLA": json.dumps(told), "PYTHONPATH": os.pathsep.join(filter(None, paths))},
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )
    return done.returncode, done.stderr


def contents(run):
    """Return what a run's store and samples hold."""
    with closing(sqlite3.connect(run / "run.sqlite")) as store:
        rows = store.execute("SELECT * FROM evaluation").fetchall()
    with np.load(run / "samples.npz") as samples:
        return sorted(map(repr, rows)), samples["mu"].tobytes(), samples["score"].tobytes()


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    run = tmp_path_factory.mktemp("unbroken") / "run"
    code, errors = attack_elsewhere(run)
    assert code == 0, errors
    return contents(run)


@pytest.mark.long
@pytest.mark.usefixtures("one_route")
def test_an_attack_that_was_killed_ends_as_an_unbroken_one(start, tmp_path, unbroken):
    run = tmp_path / "run"
    code, errors = attack_elsewhere(run, exits_at_tick=3_000)
    assert code == 9, errors
    kept = stored(run)
    assert kept > 0
    server = start()
    result = attack(
        driven(), "level-set", out=run, resume=True, workers=Workers(chunk_size=4), **ATTACK
    )
    assert result.folder == run
    assert (run / "result.json").is_file()
    privileged = ATTACK["samples"]
    assert server.worlds == stored(run) - kept + privileged  # none was driven twice
    assert_left_as_found(server)
    assert contents(run) == unbroken


@pytest.mark.long
def test_workers_share_the_servers_of_an_attack(tmp_path, unbroken):
    run, log = tmp_path / "run", tmp_path / "log"
    code, errors = attack_elsewhere(
        run, "localhost:2000,2010", workers=2, ports=[2000, 2010], log=str(log)
    )
    assert code == 0, errors
    loaded = [line.split() for line in log.read_text(encoding="utf-8").splitlines()]
    assert {port for port, _ in loaded} == {"2000", "2010"}
    assert len({process for _, process in loaded}) >= 2
    assert contents(run) == unbroken


@pytest.mark.skipif(
    "SADA_CARLA_HOST" not in os.environ,
    reason="Expected SADA_CARLA_HOST=HOST:PORT, the CARLA server to try.",
)
@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_a_real_server_is_attacked_and_left_as_it_was(tmp_path):
    host = os.environ["SADA_CARLA_HOST"]
    client = carla.Client(host.partition(":")[0], int(host.partition(":")[2].split(",")[0] or 2000))
    client.set_timeout(60.0)
    before = client.get_world().get_settings()
    application = CarlaDrivingApplication("straight", episodes=1)
    assert application.evaluate([application.nominal], [0]).score >= 0.8  # by the autopilot
    attack(application, "random", out=tmp_path / "run", **{**ATTACK, "budget": 2})
    world = client.get_world()
    after = world.get_settings()
    assert (after.synchronous_mode, after.fixed_delta_seconds) == (
        before.synchronous_mode,
        before.fixed_delta_seconds,
    )
    assert not list(world.get_actors().filter("vehicle.*"))
    assert not list(world.get_actors().filter("sensor.*"))
