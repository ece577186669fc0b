import gymnasium as gym
import numpy as np
import pytest
from toy import Toy

from sada_gym import GymnasiumApplication
from sada_gym.envs import AdversaryEnv
from sada_gym.errors import UserError
from sada_gym.foundations.frames import as_frame

SHAPE = (4, 6, 3)
SHADES = np.linspace(0.0, 1.0, 72).reshape(SHAPE)
BYTES = np.rint(255 * SHADES).astype(np.uint8)


@pytest.mark.parametrize(
    ("given", "frame"),
    [
        (BYTES, BYTES),
        (BYTES.astype(np.int64), BYTES),
        (BYTES.astype(np.float32), BYTES),
        (BYTES.tolist(), BYTES),
        (SHADES, BYTES),
        (SHADES.astype(np.float32), BYTES),
        (SHADES + 1e-7, BYTES),
        (np.ones(SHAPE, bool), np.full(SHAPE, 255)),
        (np.zeros(SHAPE, bool), np.zeros(SHAPE)),
        (BYTES[..., 0], BYTES[..., [0, 0, 0]]),
        (BYTES[..., :1], BYTES[..., [0, 0, 0]]),
        (np.dstack([BYTES, np.full((4, 6), 255, np.uint8)]), BYTES),
        (np.dstack([BYTES, np.zeros((4, 6), np.uint8)]), np.full(SHAPE, 255)),
        (np.dstack([np.zeros(SHAPE), np.full((4, 6), 0.2)]), np.full(SHAPE, 204)),
    ],
)
def test_pictures_of_all_kinds_become_rgb(given, frame):
    made = as_frame(given, "X.render")
    assert made.dtype == np.uint8
    np.testing.assert_array_equal(made, frame)


@pytest.mark.parametrize(
    ("given", "came"),
    [
        (np.full(SHAPE, -56), "values from -56 to -56"),
        (np.full(SHAPE, 256), "values from 256 to 256"),
        (np.full(SHAPE, np.nan), "values from nan to nan"),
        (np.full(SHAPE, -0.5), "values from -0.5 to -0.5"),
        (np.full(SHAPE, 1j), "ndarray of shape (4, 6, 3) and type complex128"),
        (BYTES.astype(object), "ndarray of shape (4, 6, 3) and type object"),
        ([BYTES, BYTES], "list of shape (2, 4, 6, 3) and type uint8"),
        ([BYTES, BYTES[:2]], "list of shape (2,) and type object"),
        (np.zeros((0, 6, 3), np.uint8), "ndarray of shape (0, 6, 3)"),
        (np.zeros((4, 0, 3)), "ndarray of shape (4, 0, 3)"),
        (np.zeros((4, 6, 2)), "ndarray of shape (4, 6, 2)"),
        ("+--+\n|  |", "str of shape ()"),
        (None, "NoneType of shape ()"),
    ],
)
def test_what_is_no_picture_is_refused(given, came):
    with pytest.raises(UserError) as raised:
        as_frame(given, "X.render")
    assert str(raised.value).endswith("Fix X.render.")
    assert f"uint8, got {came}" in str(raised.value)


class Screen(gym.Env):
    observation_space, action_space = gym.spaces.Box(-1, 1, (1,)), gym.spaces.Discrete(2)
    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(self, x=0.0, render_mode=None):
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        return np.zeros(1, np.float32), {}

    def step(self, action):
        return np.zeros(1, np.float32), 1.0, True, False, {}

    def render(self):
        return np.dstack([SHADES, np.ones((4, 6))])


class Drawn(Toy):
    def render(self, mu, seed):
        return SHADES


def test_frames_are_rgb_wherever_an_environment_or_an_application_is_drawn():
    wrapped = GymnasiumApplication(
        Screen,
        agent=lambda observation: 0,
        agent_id="still",
        parameters={"x": (0.0, 1.0)},
        score=("return", 0.0, 1.0),
        fooling_threshold=0.5,
        max_steps=1,
    )
    frames, _ = wrapped.replay([0.0], 0)
    env = AdversaryEnv(Drawn(), render_mode="rgb_array")
    env.reset(seed=0)
    again, _ = env.replay([0.0] * env.action_space.shape[0], 0)
    drawn = [*frames, *again, wrapped.render([0.0], 0), wrapped.observation([0.0], 0), env.render()]
    for frame in drawn:
        np.testing.assert_array_equal(frame, BYTES)
