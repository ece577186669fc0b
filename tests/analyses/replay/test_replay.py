"""Replays: which samples, which application, the same scores, the right reasons."""

from __future__ import annotations

import json
from pathlib import Path
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
from families import family
from PIL import Image

from sada_gym import (
    Application,
    GymnasiumApplication,
    Parameter,
    ParameterSpace,
    Scored,
    attack,
    make_application,
)
from sada_gym.analyses.replay import replay
from sada_gym.analyses.replay.captions import BAR, DONE, FAILED, HOLD_S, WIDTH, fit
from sada_gym.analyses.replay.clip import make_clip
from sada_gym.analyses.replay.shots import describe_world, pace, path_to, scored_ending, share_time
from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.uav.behaviour import ending as race_ending
from sada_gym.envs.uav.episodes import RacingStart
from sada_gym.envs.uav.world.referee import GateOutcome
from sada_gym.errors import FileError, Notice, UserError
from sada_gym.run.folder import read_samples, write_samples


def run(folder: Path, environment="SADA-Analytic-v0", **keywords) -> Path:
    given = {"budget": 0, "samples": 12, "pictures": False, **keywords}
    return attack(environment, "random", seed=0, out=folder, **given).folder


@pytest.fixture(scope="module")
def analytic(tmp_path_factory) -> Path:
    return run(tmp_path_factory.mktemp("run") / "analytic")


class Counting(Application):
    """Counts up to mu; its episode has frames, and its info says how it ended."""

    name = "Counting"
    fooling_threshold = 0.5
    sample_size = 5
    render_fps = 10
    parameters = ParameterSpace(Parameter("speed_m_s", 0.0, 1.0, "m/s"))
    frames = 30

    def evaluate_batch(self, mu, seeds):
        score = self.parameters.physical(mu)[:, 0]
        return Scored(score, [{"ending": f"stopped at {s:.1f}"} for s in score])

    def render(self, mu, seed):
        return np.full((50, 80, 3), 200, np.uint8)

    def replay(self, mu, seed):
        score = float(self.evaluate(mu[None], [seed]).score[0])
        return [np.full((50, 80, 3), i, np.uint8) for i in range(self.frames)], score


def test_the_worst_samples_follow_one_another(analytic):
    samples = read_samples(analytic / "samples.npz")
    video = replay(analytic, worst=3, seconds=2)
    scores = [sample.score for sample in video.samples]
    assert scores == sorted(samples.score.tolist())[:3]
    assert [sample.sample for sample in video.samples] == np.argsort(samples.score)[:3].tolist()
    assert video.times_s.count(HOLD_S) == 3
    assert {frame.shape for frame in video.frames} == {(400 + BAR, WIDTH, 3)}
    assert replay(analytic, seconds=2).samples == video.samples[:1]


def test_one_sample_by_its_row_ends_in_blue_where_the_agent_did_well(analytic):
    samples = read_samples(analytic / "samples.npz")
    best, worst = int(samples.score.argmax()), int(samples.score.argmin())
    for row, colour in ((best, DONE), (worst, FAILED)):
        video = replay(analytic, sample=row, seconds=2)
        assert video.samples[0].sample == row
        assert tuple(video.frames[-1][-1, -1]) == colour
        assert video.samples[0].fooled == (colour == FAILED)


@pytest.mark.parametrize(
    ("track", "keywords"),
    [
        ("SADA-Analytic-v0", {"dimension": 3, "volume": 0.2}),
        ("SADA-Digits-v0", {"digit": 3, "parameters": ["scale", "shear"]}),
        ("SADA-Pixel-v0", {"radius": 0.3}),
        ("SADA-Detection-v0", {"object_class": "bus", "image_size": 64}),
    ],
)
def test_settings_open_the_application_again(tmp_path, track, keywords):
    folder = run(tmp_path / "run", track, env_kwargs=keywords)
    assert (
        replay(folder, seconds=1).samples[0].score
        == read_samples(folder / "samples.npz").score.min()
    )


def test_an_application_of_ones_own_is_passed(tmp_path):
    folder = run(tmp_path / "run", Counting(), samples=3)
    with pytest.raises(UserError, match=r"in Python, hand it over: application=YOURS"):
        replay(folder)
    video = replay(folder, application=Counting(), seconds=2)
    assert video.samples[0].endings == (f"stopped at {video.samples[0].score:.1f}",)
    # the last two seconds, and the ending
    assert len(video.frames) == 21
    assert video.seconds == pytest.approx(2 + HOLD_S)


def test_an_application_that_differs_is_refused(tmp_path, analytic):
    with pytest.raises(UserError, match=r"settings.dimension was 2 and is 3"):
        replay(analytic, application=make_application("SADA-Analytic-v0", dimension=3))
    with pytest.raises(UserError, match="Expected an Application, an environment's id or a TOML"):
        replay(analytic, application=3)


def altered(source: Path, folder: Path, **changes) -> Path:
    """Copy a run with other settings."""
    folder.mkdir()
    record = json.loads((source / "attack.json").read_text())
    settings = record["settings"]
    target = settings["experiment"]["target"]
    for name, value in changes.items():
        level = next(d for d in (target, target["application"], settings) if name in d)
        level[name] = value
    (folder / "attack.json").write_text(json.dumps(record))
    (folder / "samples.npz").write_bytes((source / "samples.npz").read_bytes())
    return folder


def test_another_agent_or_version_is_one_clear_error(tmp_path, analytic):
    folder = altered(analytic, tmp_path / "a", fingerprint="0" * 64)
    with pytest.raises(UserError, match=r"got another: fingerprint was '000000"):
        replay(folder)
    folder = altered(analytic, tmp_path / "b", version=7)
    with pytest.raises(UserError, match=r"version was 7 and is 0"):
        replay(folder)
    folder = altered(analytic, tmp_path / "c", agent="no-such-agent")
    with pytest.raises(UserError, match="open SADA-Analytic-v0 against no-such-agent as"):
        replay(folder)


def test_another_score_is_refused_and_a_rounding_is_told(tmp_path, analytic):
    folder = altered(analytic, tmp_path / "run")
    samples = read_samples(folder / "samples.npz")
    row = int(samples.score.argmin())
    for off, refused in ((0.01, True), (1e-9, False)):
        score = samples.score.copy()
        score[row] += off
        write_samples(folder / "samples.npz", type(samples)(samples.mu, score, samples.seed))
        if refused:
            with pytest.raises(UserError, match=rf"Expected Q = \S+ of sample {row}, as the run"):
                replay(folder, sample=row, out=tmp_path / "video.gif")
            assert not (tmp_path / "video.gif").exists()
        else:
            (sample,) = replay(folder, sample=row, seconds=1).samples
            assert sample.score != sample.stored


def test_versions_that_differ_are_named_with_another_score(tmp_path, analytic):
    packages = json.loads((analytic / "attack.json").read_text())["settings"]["packages"]
    folder = altered(analytic, tmp_path / "run", packages={**packages, "numpy": "0.1"})
    assert replay(folder, seconds=1).samples  # other versions alone are no reason
    samples = read_samples(folder / "samples.npz")
    write_samples(
        folder / "samples.npz", type(samples)(samples.mu, samples.score / 2, samples.seed)
    )
    with pytest.raises(UserError, match=r"numpy was 0\.1 and is"):
        replay(folder)


def test_a_folder_without_a_finished_run_is_refused(tmp_path, analytic):
    with pytest.raises(FileError, match=r"which holds no attack\.json"):
        replay(tmp_path)
    folder = altered(analytic, tmp_path / "run")
    (folder / "samples.npz").unlink()
    with pytest.raises(FileError, match=r"Finish it with --resume"):
        replay(folder)


def test_an_application_without_pictures_is_refused(tmp_path):
    class Blind(Counting):
        def replay(self, mu, seed):
            return Application.replay(self, mu, seed)

        render = Application.render

    folder = run(tmp_path / "run", Blind(), samples=2)
    with pytest.raises(UserError, match="draws no pictures"):
        replay(folder, application=Blind())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (([np.zeros(5)] * 9, 0.1), r"of shape \(5,\) and type float64. Fix Bad.replay"),
        (([], 0.1), "Expected frames from Bad.replay, got none"),
        ([np.zeros((5, 5, 3), np.uint8)], "a list of frames and a score from Bad.replay, got"),
        ((3, 0.1), r"a score from Bad.replay, got \(3, 0.1\)"),
        (([np.zeros((5, 5, 3), np.uint8)], None), "a score from Bad.replay, got"),
    ],
)
def test_a_bad_replay_is_refused(tmp_path, given, message):
    class Bad(Counting):
        def replay(self, mu, seed):
            return given

    folder = run(tmp_path / "run", Bad(), samples=2)
    with pytest.raises(UserError, match=message):
        replay(folder, application=Bad())


def test_an_ending_is_one_line():
    assert scored_ending(0.2, 0.5, "hit a wall") == "hit a wall"
    assert scored_ending(0.2, 0.5, "") == "Q = 0.20: fooled"
    assert scored_ending(0.2, 0.5, "hit\x1b[31m\na wall") == r"hit\x1b[31m\na wall"


class Drawing(gym.Env):
    """Its episodes have five steps; `draw` says what its frames are."""

    metadata: ClassVar = {"render_modes": ["rgb_array"], "render_fps": 10}
    observation_space = gym.spaces.Box(-1.0, 1.0, (1,))
    action_space = gym.spaces.Discrete(2)

    def __init__(self, draw, size=1.0, render_mode=None):
        self.draw, self.size, self.render_mode = draw, size, render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.steps += 1
        return np.zeros(1, np.float32), self.size, self.steps == 5, False, {}

    def render(self):
        return self.draw(self.steps)


def no_screen(step):
    raise RuntimeError("no OpenGL")


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (no_screen, "Expected .*make to draw a frame, got RuntimeError: no OpenGL"),
        (lambda step: np.zeros((9 + step, 9, 3), np.uint8), r"one size from .*\(10, 9, 3\) after"),
    ],
)
def test_an_environment_that_draws_badly_is_named(tmp_path, draw, message):
    application = drawing_application(draw)
    folder = run(tmp_path / "run", application, samples=2)
    with pytest.raises(UserError, match=message):
        replay(folder, application=application)


@pytest.mark.parametrize("fps", [0, None, np.nan, "fast"])
def test_frames_need_a_pace(tmp_path, fps):
    class Still(Counting):
        render_fps = fps

    folder = run(tmp_path / "run", Still(), samples=2)
    with pytest.raises(UserError, match=f"Expected `render_fps` of Still above 0, got {fps!r}"):
        replay(folder, application=Still())


def drawing_application(draw, fps=10, kind=GymnasiumApplication, **keywords):
    def make(size=1.0, render_mode=None):
        env = Drawing(draw, size, render_mode)
        env.metadata = {**Drawing.metadata, "render_fps": fps}
        return env

    return kind(
        make,
        agent=lambda observation: 0,
        agent_id="still",
        parameters={"size": (0.0, 1.0)},
        score=("return", 0.0, 5.0),
        fooling_threshold=0.5,
        max_steps=9,
        **keywords,
    )


@pytest.mark.parametrize(
    ("fps", "known"),
    [(0.5, 0.5), (12.5, 12.5), (0, 30), (None, 30), (np.nan, 30), (-3, 30), ("fast", 30)],
)
def test_an_environments_pace_may_be_slow_or_unknown(tmp_path, fps, known):
    application = drawing_application(lambda step: np.full((9, 9, 3), 40 * step, np.uint8), fps)
    assert application.render_fps == known
    folder = run(tmp_path / "run", application, samples=2)
    video = replay(folder, application=application)
    assert video.seconds < 12.0
    assert len({frame.tobytes() for frame in video.frames}) >= 6


def test_a_slow_pace_is_shown_faster_and_says_so():
    assert pace(9, 0.5, 10.0) == (range(9), 1.0, "  ·  time lapse")
    assert pace(1, 0.5, 10.0) == (range(1), 1.0, "  ·  time lapse")
    assert pace(9, 10.0, 10.0)[2] == "  ·  slow motion"


class Restless(Drawing):
    """Its return grows by what is drawn: each frame makes the next step worth half of it."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        worth = reward * 0.5 ** getattr(self, "drawn", self.render_mode is not None)
        return observation, worth, terminated, truncated, info


@pytest.mark.parametrize("changed_by", ["render", "render_mode"])
def test_drawing_that_changes_the_episode_is_told(tmp_path, changed_by):
    def make(size=1.0, render_mode=None):
        env = Restless(lambda step: np.zeros((90, 320, 3), np.uint8), size, render_mode)
        if changed_by == "render":
            env.drawn, draw = 0, env.draw

            def drawing(step):
                env.drawn = 1
                return draw(step)

            env.draw = drawing
        return env

    application = GymnasiumApplication(
        make,
        agent=lambda observation: 0,
        agent_id="still",
        parameters={"size": (0.5, 1.0)},
        score=("return", 0.0, 5.0),
        fooling_threshold=0.9,
        max_steps=9,
    )
    stored = application.evaluate([[0.5]], [3]).score[0]
    with pytest.warns(Notice, match="other episodes than are scored: its render"):
        frames, score = application.replay([0.5], 3)
    assert score < stored
    assert all(frame[:20].any() for frame in frames)  # which would be black
    if changed_by == "render_mode":
        with pytest.warns(Notice, match="its render_mode"):
            assert application.render([0.5], 3)[:20].any()
    folder = run(tmp_path / "run", application, samples=2)
    with pytest.raises(UserError, match="so drawing changes the episode"):
        replay(folder, application=application)


def test_frames_may_differ_in_size_and_come_one_by_one(tmp_path):
    class Growing(Counting):
        def replay(self, mu, seed):
            drawn = (np.full((10 + i, 40, 3), 9 * i, np.uint8) for i in range(20))
            return drawn, super().replay(mu, seed)[1]

    folder = run(tmp_path / "run", Growing(), samples=2)
    video = replay(folder, application=Growing(), seconds=np.int64(3))
    assert len({frame.shape for frame in video.frames}) == 1


def test_an_own_replay_goes_before_our_takes():
    """Of six steps; a film of an episode that is this short has all of them."""

    class Mine(GymnasiumApplication):
        def replay(self, mu, seed):
            frames, score = super().replay(mu, seed)
            return frames[:3], score

    mu = np.zeros(1, np.float32)
    for kind, count, note in (
        (GymnasiumApplication, 6, "step 0  ·  return 0  ·  slow motion"),
        (Mine, 3, "0.0 s  ·  slow motion"),
    ):
        application = drawing_application(
            lambda step: np.full((9, 9, 3), 40 * step, np.uint8), kind=kind
        )
        (shot,) = make_clip(application, mu, 0, 5.0).shots
        assert len(shot.pictures) == count
        assert shot.notes[0] == note


def test_a_film_of_a_single_image_draws_q_beside_it():
    clip = make_clip(make_application("SADA-Analytic-v0"), np.full(2, 0.5, np.float32), 0, 2.0)
    (shot,) = clip.shots
    assert {picture.width for picture in shot.pictures} == {WIDTH}
    assert shot.notes[-1] == f"Q = {clip.score:.2f}"
    charts = [np.asarray(picture)[:, WIDTH - 200 :] for picture in shot.pictures]
    inked = [(chart == (31, 41, 51)).all(axis=-1).sum() for chart in charts]
    assert inked[0] < inked[5] < inked[-1]


def test_the_way_to_a_world_ends_there_exactly():
    mu = np.array([0.3, -0.9], np.float32)
    way = path_to(mu, 10)
    assert (way[0] == 0).all()
    assert (way[-1] == mu).all()
    assert len(path_to(mu, 1)) == 8


def test_failures_share_the_time():
    assert share_time([], 10) == ([0], 10)
    assert share_time([3], 10) == ([3], 10)
    assert share_time([1, 2, 4], 10) == ([1, 2], 5)
    assert share_time([1, 2, 4], 3) == ([1], 3)


def test_pace():
    assert pace(500, 50, 4)[:2] == (range(499, 499 - 67 * 3, -3)[::-1], 50 / 3)
    kept, fps, remark = pace(10, 50, 4)
    assert (list(kept), fps) == ([*range(10)], 5)
    assert "slow" in remark
    assert pace(1000, 1, 10)[0] == range(990, 1000)


def test_worlds_in_words():
    application = make_application("SADA-Driving-Navigation-v0")
    mu = np.array([-0.9, 0.1, 0.5], np.float32)
    assert describe_world(application, mu, 2) == "camera height 1.05 m, weather WetCloudyNoon"


@pytest.mark.parametrize("size", [(600, 400), (84, 84), (160, 210), (2000, 100), (3, 900)])
def test_pictures_of_any_size_fit(size):
    fitted = fit(Image.new("RGB", size, "red"))
    assert fitted.width == WIDTH
    assert 1 <= fitted.height <= 400


@pytest.mark.parametrize(
    ("code", "at", "text"),
    [
        (GateOutcome.HIT, (10.0, 1.2, 2.0), "hit the frame of gate 2"),
        (GateOutcome.HIT, (5.0, 0.0, 0.02), "hit the ground before gate 2"),
        (GateOutcome.LATE, (5.0, 0.0, 2.0), "not through gate 2 in 10 s"),
        (GateOutcome.LOST, (90.0, 0.0, 2.0), "lost on the way to gate 2"),
    ],
)
def test_a_race_says_how_a_gate_was_missed(code, at, text):
    gates = np.array([[0.0, 0.0, 2.0, 0.0], [10.0, 0.0, 2.0, 0.0]])
    endings = np.array([[GateOutcome.PASSED, GateOutcome.AHEAD], [GateOutcome.PASSED, code]])
    ended_at = np.zeros((2, 2, 3))
    ended_at[1, 1] = at
    snapshots = {"endings": endings, "ended_at": ended_at}
    rollout = Rollout(RacingStart(gates, (0, 0, 2, 0)), snapshots, 0.5)
    assert race_ending(rollout) == (text, 1)


TRACKS = family(
    [
        *("SADA-Digits-3-v0", "SADA-Pixel-v0", "SADA-Detection-Car-v0", "SADA-UAV-3Anchors-v0"),
        *("SADA-Driving-Straight-v0", "SADA-Robot-v0"),
    ],
    "SADA-Digits-3-v0",
    "SADA-Pixel-v0",
    "SADA-Detection-Car-v0",
)


@pytest.mark.long
@pytest.mark.parametrize("track", TRACKS)
def test_every_application_tells_its_endings(tmp_path, track):
    """The score is the application's own, and so is the verdict that the video gives."""
    folder = run(tmp_path / "run", track, samples=4)
    video = replay(folder, worst=2, seconds=5, out=tmp_path / "video.gif")
    samples = read_samples(folder / "samples.npz")
    application = make_application(track)
    for sample in video.samples:
        assert sample.score == samples.score[sample.sample]
        colour = FAILED if sample.fooled else DONE
        assert all(sample.endings)
        if track.startswith(("SADA-Digits", "SADA-Pixel", "SADA-Detection")):
            last_frames = [
                f for f, t in zip(video.frames, video.times_s, strict=True) if t == HOLD_S
            ]
            assert tuple(last_frames[video.samples.index(sample)][-1, -1]) == colour
        (info,) = application.evaluate(samples.mu[[sample.sample]], [sample.seed]).infos
        said = {"left_lane": "left its lane on the ", "hit": "hit the", "collided": "hit "}
        for ending in info.get("endings", [])[:1]:
            assert said.get(ending, "") in sample.endings[0]
    assert video.size <= 2_000_000 * max(1, video.seconds / 10)
    assert video.path is not None
    assert Image.open(video.path).is_animated
