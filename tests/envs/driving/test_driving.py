import numpy as np
import pytest

from sada_gym.envs import AdversaryEnv, AdversaryVectorEnv
from sada_gym.envs.driving.application import DrivingApplication
from sada_gym.envs.driving.camera.pinhole import Mount, camera
from sada_gym.envs.driving.episodes import POLICY_HZ, DrivingEnd, DrivingEpisodes, DrivingStart
from sada_gym.envs.driving.world.route import LAYOUT, benchmark_routes
from sada_gym.envs.driving.world.weather import NAMES

MU = [[-0.2, 0.0, -0.9], [0.0, 1.0, -0.5], [1.0, 0.8, 0.0], [-1.0, -0.4, 0.3], [0.6, 0.2, 0.7]]


@pytest.fixture(scope="module")
def application():
    return DrivingApplication("one_curve")


@pytest.mark.parametrize(
    ("task", "scores"),
    [
        ("straight", [1.0, 0.6, 0.2, 0.6, 1.0]),
        ("one_curve", [1.0, 0.0, 0.2, 0.4, 0.6]),
        ("navigation", [1.0, 0.0, 0.0, 0.0, 0.0]),
    ],
)
def test_golden_drives(task, scores):
    outcomes = DrivingApplication(task).evaluate(MU, [7] * len(MU))
    assert outcomes.score.tolist() == scores
    assert outcomes.fooled.tolist() == [score <= 0.6 for score in scores]


def test_golden_frames():
    route = benchmark_routes("navigation")[0]
    drives = DrivingEpisodes(
        camera(LAYOUT), [DrivingStart(route, Mount(), w, 5) for w in range(len(NAMES))]
    )
    drives.states[:, :3] = [*route.points[60], route.heading[60]]
    means = [
        [133.43, 135.18, 132.50],
        [123.89, 125.99, 124.73],
        [103.16, 104.18, 104.64],
        [105.46, 87.03, 78.17],
        [114.76, 114.70, 111.43],
        [96.55, 82.75, 76.61],
    ]
    pictures = drives.render(np.arange(len(NAMES)))
    np.testing.assert_allclose(pictures.mean(axis=(1, 2)), means, atol=0.05)


def test_an_info_says_how_each_route_ended(application):
    info = application.evaluate([MU[2]], [7]).infos[0]
    assert info["weather"] == "ClearSunset"
    assert info["parameters"]["camera_height_m"] == 2.0
    assert info["endings"] == ["left_lane"] * 4 + ["arrived"]
    assert info["progress"].tolist() == pytest.approx([0.499, 0.498, 0.534, 0.574, 1.0], abs=1e-3)


def test_the_weather_is_one_of_six_by_equal_parts_of_the_axis(application):
    places = np.linspace(-1, 1, 13, dtype=np.float32)[:-1] + 0.01
    weathers = [
        application.camera_and_weather(np.array([0, 0, place], np.float32))[1] for place in places
    ]
    assert weathers == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    assert application.camera_and_weather(np.array([0, 0, 1], np.float32))[1] == 5


def test_the_seed_is_the_rains(application):
    def seen(weather, seed):
        drives = application.episodes(np.array([[0, 0, weather]], np.float32), [seed])
        return drives.render(np.zeros(1, np.intp))

    for weather, differs in zip(np.linspace(-0.9, 0.9, 6), (0, 0, 1, 0, 0, 1), strict=True):
        assert bool((seen(weather, 1) != seen(weather, 2)).any()) == differs


@pytest.mark.long
def test_a_dry_world_is_driven_once_for_all_seeds(application, monkeypatch):
    counts = []
    episodes = DrivingApplication.episodes

    def counted(self, mu, seeds):
        drives = episodes(self, mu, seeds)
        counts.append(len(drives))
        return drives

    monkeypatch.setattr(DrivingApplication, "episodes", counted)
    dry, wet = MU[0], [0.0, 0.0, 0.9]
    worlds = [(dry, 1), (wet, 1), (dry, 2), (wet, 2)]
    outcomes = application.evaluate(*zip(*worlds, strict=True))
    assert counts == [15]
    for i, (mu, seed) in enumerate(worlds):
        alone = application.evaluate([mu], [seed])
        assert alone.score[0] == outcomes.score[i]
        assert alone.infos[0]["seed"] == outcomes.infos[i]["seed"] == seed
        np.testing.assert_array_equal(alone.infos[0]["progress"], outcomes.infos[i]["progress"])


def crossed(picture):
    """Count the pixels of crosses."""
    return (np.abs(picture - (213, 94, 0)) < 8).all(axis=-1).sum()


@pytest.mark.long
def test_a_replay_shows_every_step_and_how_each_drive_ended(application):
    rollouts = application.rollouts(MU[2], 7)
    info = application.evaluate([MU[2]], [7]).infos[0]
    endings = [DrivingEnd(rollout["ending"][-1]) for rollout in rollouts]
    assert [ending.name.lower() for ending in endings] == info["endings"]
    frames, score = application.replay(MU[2], 7)
    assert score == np.mean([rollout.score for rollout in rollouts]) == info["score"]
    assert AdversaryEnv(application).metadata["render_fps"] == POLICY_HZ
    assert AdversaryVectorEnv(application).metadata["render_fps"] == POLICY_HZ
    steps = sum(len(rollout["states"]) for rollout in rollouts)
    assert len(frames) == steps + 4 * len(rollouts)  # a second's stay at each end
    assert len({frame.shape for frame in frames}) == 1
    first, last = frames[0].astype(int), frames[len(rollouts[0]["states"]) - 1].astype(int)
    assert crossed(last) > 20  # the cross where it left its lane
    assert (np.abs(first - last).max(axis=2) > 30).mean() > 0.2


def test_a_picture_marks_where_drives_failed(application):
    arrived, failed = (application.render(mu, 7)[260:-34].astype(int) for mu in (MU[0], MU[2]))
    for town_map, fewest, most in ((arrived, 0, 0), (failed, 100, 10_000)):
        assert fewest <= crossed(town_map) <= most


def test_an_unknown_task_lists_the_known_ones():
    with pytest.raises(ValueError, match="a task among straight, one_curve, navigation, got 'car'"):
        DrivingApplication("car")


def test_an_agent_of_another_application_is_refused():
    with pytest.raises(ValueError, match=r"an agent's name among cil.*, got 'photographer'"):
        DrivingApplication(agent="photographer")
    with pytest.raises(ValueError, match=r"got the file mine\.zip\. SB3's files hold pickles"):
        DrivingApplication(agent="mine.zip")


def test_a_driver_with_other_weights_is_refused(tmp_path, monkeypatch):
    from sada_gym import agents

    copy = tmp_path / "cil.safetensors"
    copy.write_bytes(agents.card("cil").path.read_bytes() + b"more")
    monkeypatch.setattr(agents.AgentCard, "path", property(lambda _: copy))
    with pytest.raises(ValueError, match="the shipped weights were changed"):
        DrivingApplication(agent="cil")
