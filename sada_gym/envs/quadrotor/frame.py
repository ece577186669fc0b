"""Pictures of a flight for people: the quadrotor from the side with its way and its reference."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.quadrotor.start import (
    MOTORS,
    PARAMETERS,
    PLATFORMS,
    POLICY_HZ,
    FlightEnd,
    QuadrotorStart,
)
from sada_gym.envs.quadrotor.world.dynamics import BOUND_M, HEIGHT_M, LOST_M, SETTLED, STEPS
from sada_gym.envs.quadrotor.world.dynamics import reference as reference_at
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import INK_RGB, caption, cross, dashed, font, ring, stacked
from sada_gym.foundations.frames import BLUE, GREEN, VERMILLION, Colour, Frame, LegendEntry, rgb

WIDTH, HEIGHT, CHART = 700, 400, 110
_FINE = 2
"""Pictures are drawn larger by this factor and then made smaller, so that edges are smooth."""
_SKY, _GROUND, _GRID, _SHADE = (238, 243, 248), (222, 226, 218), (196, 202, 190), (170, 176, 164)
_FIGURE, _FLOWN, _TARGET, _FAILED = (150, 158, 168), rgb(BLUE), rgb(GREEN), rgb(VERMILLION)
_FRONT, _BACK, _COURSE = (200, 60, 50), (70, 78, 90), (214, 240, 224)
_TURNED, _RAISED = math.radians(-60.0), math.radians(20.0)
"""The view's direction: from behind and the right, and from above."""
_METRE, _ARM_M, _EDGE_M = 135.0, 0.14, 2.5
"""A metre's pixels; the arms, drawn longer than a Crazyflie's, which would be a dot; the floor."""
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 24)
_TEXT = 17

LEGEND = (
    LegendEntry("figure of the reference", "#969ea8", "dashed line"),
    LegendEntry("reference", GREEN, "disc"),
    LegendEntry("way flown", BLUE, "line"),
    LegendEntry("front motors", "#c83c32", "disc"),
    LegendEntry("failed here", VERMILLION, "cross"),
    LegendEntry("Below: the distance from the reference over time. Quadrotors are drawn enlarged."),
)


def summary(rollouts: Sequence[Rollout[QuadrotorStart]]) -> Frame:
    """Draw the end of the flight, with what happened and the conditions."""
    (rollout,) = rollouts
    values = rollout.start.conditions.values()
    lines = PARAMETERS.lines(values, 4)
    end = FlightEnd(int(rollout["told"][-1, 5])).name.lower()
    title = (
        f"{PLATFORMS[rollout.start.platform].title}: {end} after {rollout.last / POLICY_HZ:.1f} s, "
        f"on course for {rollout.score:.0%} of the time"
    )
    text = caption("\n".join([title, *lines]), WIDTH, _TEXT)
    return stacked([text, snapshot(rollout, rollout.last)])


def picture(
    rollouts: Sequence[Rollout[QuadrotorStart]], i: int, step: int
) -> tuple[Image.Image, str]:
    """Draw a step of flight i, and say when that is."""
    away_m, wind_m_s = rollouts[i]["told"][step, 0], rollouts[i]["winds"][step, 0]
    text = f"{step / POLICY_HZ:4.1f} s   {away_m:4.2f} m away   wind {wind_m_s:+.1f} m/s"
    return snapshot(rollouts[i], step), text


def observation(rollout: Rollout[QuadrotorStart], step: int = 0) -> Frame:
    """Draw the quadrotor and its reference after some steps."""
    return draw_frame(rollout.start, rollout["states"][step], rollout["targets"][step])


def draw_frame(start: QuadrotorStart, state: Floats, target: Floats) -> Frame:
    """Draw a quadrotor in a state (17,), and its reference (4,): see `QuadrotorEpisodes`."""
    return np.asarray(_Scene(start, state[None], target).finished())


def snapshot(rollout: Rollout[QuadrotorStart], step: int) -> Image.Image:
    """Draw a step of a flight with the way until then, above the distance over time."""
    scene = _Scene(rollout.start, rollout["states"], rollout["targets"][step], step + 1)
    if rollout["told"][step, 5] > FlightEnd.FLOWN:
        scene.failed(rollout["states"][step, :3])
    return Image.fromarray(stacked([scene.finished(), _chart(rollout["told"][:, 0], step)]))


def _chart(away_m: Floats, step: int) -> Image.Image:
    chart = Image.new("RGB", (WIDTH * _FINE, CHART * _FINE), "white")
    draw, face = ImageDraw.Draw(chart), font(18 * _FINE)
    most = float(np.clip(away_m.max(), 2 * BOUND_M, LOST_M))

    def at(place: float, metres: float) -> tuple[float, float]:
        share = min(metres / most, 1.0)
        return _FINE * (90 + 580 * place / STEPS), _FINE * (CHART - 32 - (CHART - 43) * share)

    draw.rectangle((*at(SETTLED, BOUND_M), *at(STEPS, 0.0)), _COURSE)
    draw.line([at(0, most), at(0, 0.0), at(STEPS, 0.0)], INK_RGB, _FINE)
    draw.line([at(k, x) for k, x in enumerate(away_m[: step + 1].tolist())], _FLOWN, 2 * _FINE)
    for metres in (0.0, BOUND_M if most < 4 * BOUND_M else most, most):
        across, down = at(0, metres)
        draw.text((across - 12, down), f"{metres:.1f} m", INK_RGB, face, "rm")
    for place in range(0, STEPS + 1, 2 * POLICY_HZ):
        across, down = at(place, 0.0)
        draw.text((across, down + 18), f"{place // POLICY_HZ} s", INK_RGB, face, "mt")
    return chart.resize((WIDTH, CHART), Image.Resampling.BOX)


def _seen(points: Floats) -> Floats:
    """Return how far to the right and up of the figure's middle points (k, 3) are seen, in m."""
    x, y, z = points.T
    away = x * math.sin(_TURNED) + y * math.cos(_TURNED)
    up = (z - HEIGHT_M) * math.cos(_RAISED) + away * math.sin(_RAISED)
    return np.stack([x * math.cos(_TURNED) - y * math.sin(_TURNED), up], axis=1)


class _Scene:
    """A view from the side, with a quadrotor after the first `until` of its states (k, 17)."""

    def __init__(
        self, start: QuadrotorStart, states: Floats, target: Floats, until: int = 1
    ) -> None:
        right, up = _seen(states[:, :3]).T  # all of the flight is in view
        tall = max(up.max() / 0.3, -up.min() / 0.55) / HEIGHT
        self._metre = 1 / max(1 / _METRE, abs(right).max() / (0.45 * WIDTH), tall)
        self._picture = Image.new("RGB", (WIDTH * _FINE, HEIGHT * _FINE), _SKY)
        self._draw = ImageDraw.Draw(self._picture)
        edges = np.arange(-_EDGE_M, _EDGE_M + 0.1, 0.5)
        floor = [[x, y, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        self._draw.polygon(self._at(np.array(floor) * _EDGE_M), _GROUND)
        for place in edges.tolist():
            across = np.array([[place, -_EDGE_M, 0.0], [place, _EDGE_M, 0.0]])
            self._line(across, _GRID, 1)
            self._line(across[:, [1, 0, 2]], _GRID, 1)
        speed = start.conditions["speed_m_s"]
        if speed > 0.0:
            lap_s = 2 * math.pi * math.sqrt(2.0) / speed
            way = [(*reference_at(3 + k / 100 * lap_s, speed)[:2], HEIGHT_M) for k in range(101)]
            dashed(self._draw, self._at(np.array(way)), _FIGURE, 2 * _FINE, 16, 12)
        self._line(states[:until, :3], _FLOWN, 3)
        goal = np.array([*target[:2], HEIGHT_M])
        self._line(np.stack([goal, goal * [1, 1, 0]]), _FIGURE, 1)
        self._disc(goal, 6, _TARGET)
        self._quadrotor(states[until - 1])

    def _at(self, points: Floats) -> list[tuple[float, float]]:
        """Return where points (k, 3) lie in the picture."""
        pixels = [WIDTH / 2, 0.36 * HEIGHT] + _seen(points) * [self._metre, -self._metre]
        return [(x, y) for x, y in (_FINE * pixels).tolist()]

    def _line(self, points: Floats, colour: Colour, width: int) -> None:
        self._draw.line(self._at(points), colour, width * _FINE, joint="curve")

    def _disc(self, place: Floats, radius: float, colour: Colour) -> None:
        (middle,) = self._at(place[None])
        self._draw.circle(middle, radius * _FINE, colour, INK_RGB, _FINE)

    def _quadrotor(self, state: Floats) -> None:
        place, (w, x, y, z) = state[:3], state[3:7]
        ahead = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
        left = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
        round_it = np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE), 0 * _CIRCLE], axis=1)
        self._draw.polygon(self._at(place * [1, 1, 0] + 0.12 * round_it), _SHADE)
        propeller = 0.09 * round_it[:, :2] @ np.stack([ahead, left])
        middles = [place + _ARM_M * (a * ahead + b * left) for a, b, _ in MOTORS]
        for middle in middles:
            self._line(np.stack([place, middle]), INK_RGB, 4)
        for middle, (front, _, _), throttle in zip(middles, MOTORS, state[13:], strict=True):
            shades = _FRONT if front > 0 else _BACK
            shown = tuple(round(255 - (255 - part) * (0.25 + 0.75 * throttle)) for part in shades)
            self._draw.polygon(self._at(middle + propeller), shown, INK_RGB)
        self._disc(place, 5, INK_RGB)

    def failed(self, place: Floats) -> None:
        (middle,) = self._at(place[None])
        ring(self._draw, *middle, 40 * _FINE)
        cross(self._draw, middle, 12 * _FINE, _FAILED, (7 * _FINE, 4 * _FINE))

    def finished(self) -> Image.Image:
        return self._picture.resize((WIDTH, HEIGHT), Image.Resampling.BOX)
