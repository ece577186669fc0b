"""Frames of trips for people: the hall from above, with the robot and what its lidar returned."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.robot.start import GOAL_M, POLICY_HZ, Conditions, RobotEnd, RobotStart
from sada_gym.envs.robot.world.floor_plan import CART_RADIUS_M, HALL_M, TRIPS
from sada_gym.envs.robot.world.robot import RADIUS_M
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import INK_RGB, beside, caption, cross, font, ring, stacked
from sada_gym.foundations.frames import BLUE, VERMILLION, Frame, LegendEntry, rgb

WIDTH = 700
"""The width of a map in pixels."""
_FINE = 2
"""Maps are drawn larger by this factor and then made smaller, so that edges are smooth."""
_FLOOR, _RACK, _SHELF = (236, 238, 240), (193, 154, 107), (148, 112, 70)
_PILLAR, _BARREL, _LID, _CART = (110, 116, 124), (222, 120, 31), (246, 168, 92), (70, 110, 160)
_WAY, _DRIVEN, _RETURN = (250, 204, 21), rgb(BLUE), (220, 38, 38)
_GOAL, _FAILED, _ROBOT = (34, 197, 94), rgb(VERMILLION), (40, 44, 52)
_TEXT = 28

LEGEND = (
    LegendEntry("way planned", "#facc15", "line"),
    LegendEntry("way driven", BLUE, "line"),
    LegendEntry("robot", "#282c34", "arrow"),
    LegendEntry("goal (with a flag)", "#22c55e", "disc"),
    LegendEntry("failed here", VERMILLION, "cross"),
    LegendEntry("what the lidar returns", "#dc2626", "dots"),
    LegendEntry("rack", "#c19a6b", "square"),
    LegendEntry("pillar", "#6e747c", "disc"),
    LegendEntry("barrel", "#de781f", "disc"),
    LegendEntry("cart", "#466ea0", "disc"),
    LegendEntry(
        "Left: the end of the first trip that failed. Right: all ten trips, numbered at their "
        "goals, five on each of two floor plans."
    ),
)

_PENNANT = ((0.0, 1.0), (0.6, 0.8), (0.0, 0.6))

Rollouts = Sequence[Rollout[RobotStart]]


def summary(rollouts: Rollouts) -> Frame:
    """Draw the end of the first trip that failed, beside maps of the trips of each floor plan."""
    failed = [i for i, rollout in enumerate(rollouts) if rollout.score < 1]
    which = failed[0] if failed else 0
    rollout = rollouts[which]
    last = len(rollout["poses"]) - 1
    arrived = len(rollouts) - len(failed)
    end = _words(rollout["ending"][-1])
    maps = [_overview(rollouts[k : k + TRIPS], k) for k in range(0, len(rollouts), TRIPS)]
    pair = beside(snapshot(rollout, last), Image.fromarray(stacked(maps)))
    text = (
        f"{arrived} of {len(rollouts)} trips arrived; left: trip {which + 1} after "
        f"{last / POLICY_HZ:.1f} s, {end}\n"
    )
    text += _conditions(rollout.start.conditions)
    return stacked([caption(text, pair.width, _TEXT), pair])


def picture(rollouts: Rollouts, i: int, step: int) -> tuple[Image.Image, str]:
    """Draw a step of trip i, and say when that is."""
    ending = _words(rollouts[i]["ending"][step])
    text = f"trip {i + 1} of {len(rollouts)}   {step / POLICY_HZ:4.1f} s   {ending}"
    drawn = snapshot(rollouts[i], step)
    if step == rollouts[i].last and rollouts[i].score < 1:
        unit, (x, y, _) = WIDTH / HALL_M[0], rollouts[i]["poses"][step]
        ring(ImageDraw.Draw(drawn), x * unit, (HALL_M[1] - y) * unit, 28)
    return drawn, text


def observation(rollout: Rollout[RobotStart], step: int = 0) -> Frame:
    """Draw the hall, and what the lidar returns, after some steps."""
    poses, carts, points = (rollout[key][step] for key in ("poses", "carts", "points"))
    return draw_frame(rollout.start, poses, carts, points)


def draw_frame(start: RobotStart, pose: Floats, carts: Floats, points: Floats) -> Frame:
    """Draw the hall, the robot at a pose (3,), and what it believes to see; see `RobotEpisodes`."""
    return np.asarray(_view(start, pose, carts, points))


def _words(ending: int) -> str:
    return RobotEnd(ending).name.lower().replace("_", " ")


def snapshot(rollout: Rollout[RobotStart], step: int) -> Image.Image:
    """Draw one step of a trip, with the way that was driven until then."""
    carts, points = rollout["carts"][step], rollout["points"][step]
    return _view(rollout.start, rollout["poses"][step], carts, points, rollout["poses"][: step + 1])


def _view(
    start: RobotStart, pose: Floats, carts: Floats, points: Floats, driven: Floats | None = None
) -> Image.Image:
    hall = _HallMap(WIDTH, start)
    hall.line(start.plan.ways[start.trip], _WAY, 0.07)
    goal_x, goal_y = start.plan.ways[start.trip][-1]
    hall.disc(goal_x, goal_y, GOAL_M, _GOAL)
    if driven is not None:
        hall.line(driven[:, :2], _DRIVEN, 0.04)
    hall.carts(carts)
    for x, y in points[np.isfinite(points[..., 0])]:
        hall.disc(x, y, 0.03, _RETURN)
    hall.robot(pose)
    if driven is not None:
        hall.flag(goal_x, goal_y, 2 * GOAL_M)
    return hall.finished()


def _overview(rollouts: Rollouts, first: int) -> Image.Image:
    hall = _HallMap(WIDTH // 2, rollouts[0].start)
    for rollout in rollouts:
        hall.line(rollout.start.plan.ways[rollout.start.trip], _WAY, 0.1)
    for rollout in rollouts:
        hall.line(rollout["poses"][:, :2], _DRIVEN, 0.06)
    for k, rollout in enumerate(rollouts):
        way = rollout.start.plan.ways[rollout.start.trip]
        for (x, y), colour in ((way[0], (255, 255, 255)), (way[-1], _GOAL)):
            hall.disc(x, y, 0.14, colour)
        goal_x, goal_y = way[-1]
        hall.flag(goal_x, goal_y, 0.7)
        aside = math.copysign(0.6, HALL_M[0] / 2 - goal_x)  # into the hall
        hall.text(goal_x + aside, goal_y, str(first + k + 1))
    for rollout in rollouts:
        if rollout.score < 1:
            hall.cross(*rollout["poses"][-1, :2])
    return hall.finished()


def _conditions(physics: Conditions) -> str:
    ahead = "ahead" if physics.payload_offset_m >= 0 else "behind"
    turned = _left(physics.lidar_yaw_deg, "°")
    aside = _left(100 * physics.lidar_offset_m, " cm")
    return (
        f"friction {physics.floor_friction:.2f}, payload {physics.payload_kg:.1f} kg, "
        f"{100 * abs(physics.payload_offset_m):.0f} cm {ahead}\n"
        f"wheels {100 * physics.wheel_gain:+.0f} %, latency {physics.latency_s:.2f} s, "
        f"{physics.barrels} barrels\nlidar: turned {turned}, {aside},\n"
        f"noise {100 * physics.lidar_noise_m:.0f} cm, "
        f"{100 * physics.lidar_dropout:.0f} % of its rays lost"
    )


def _left(amount: float, unit: str) -> str:
    return f"{abs(amount):.0f}{unit} to the {'left' if amount >= 0 else 'right'}"


class _HallMap:
    """A map of a floor plan that is being drawn, `width` pixels wide."""

    def __init__(self, width: int, start: RobotStart) -> None:
        self._size = width, round(width * HALL_M[1] / HALL_M[0])
        self._unit = _FINE * width / HALL_M[0]
        picture = Image.new("RGB", (_FINE * self._size[0], _FINE * self._size[1]), _FLOOR)
        self._picture, self._draw = picture, ImageDraw.Draw(picture)
        plan = start.plan
        for x0, y0, x1, y1 in plan.racks:
            self._box(x0, y0, x1, y1, _RACK, _SHELF)
            self.line(np.array([[x0, (y0 + y1) / 2], [x1, (y0 + y1) / 2]]), _SHELF, 0.03)
            for x in np.linspace(x0, x1, max(2, round((x1 - x0) / 0.5)) + 1)[1:-1]:
                self.line(np.array([[x, y0], [x, y1]]), _SHELF, 0.03)
        for x, y, radius in plan.pillars:
            self.disc(x, y, radius, _PILLAR)
        for x, y, radius in plan.barrels[: start.conditions.barrels]:
            self.disc(x, y, radius, _BARREL)
            self.disc(x, y, 0.7 * radius, _LID)
        self._box(0.0, 0.0, *HALL_M, None, INK_RGB)

    def _at(self, x: float, y: float) -> tuple[float, float]:
        return x * self._unit, (HALL_M[1] - y) * self._unit

    def _box(
        self,
        x0: float,
        y0: float,
        x1: float,
        y1: float,
        fill: tuple[int, ...] | None,
        edge: tuple[int, ...],
    ) -> None:
        left, top = self._at(x0, y1)
        right, bottom = self._at(x1, y0)
        width = round(0.04 * self._unit)
        self._draw.rectangle((left, top, right - 1, bottom - 1), fill, edge, width)

    def line(self, points: Floats, colour: tuple[int, ...], width_m: float) -> None:
        pixels = [self._at(x, y) for x, y in points.tolist()]
        self._draw.line(pixels, colour, max(2, round(width_m * self._unit)), joint="curve")

    def disc(self, x: float, y: float, radius: float, colour: tuple[int, ...]) -> None:
        edge = INK_RGB if radius > 0.05 else None
        width = max(1, round(0.02 * self._unit))
        self._draw.circle(self._at(x, y), radius * self._unit, colour, edge, width)

    def carts(self, places: Floats) -> None:
        for x, y in places:
            if x > 0.0:
                self.disc(x, y, CART_RADIUS_M, _CART)
                half = 0.5 * CART_RADIUS_M
                self._box(x - half, y - half, x + half, y + half, (214, 226, 240), INK_RGB)

    def robot(self, pose: Floats) -> None:
        x, y, heading = pose
        ahead, left = (
            (math.cos(heading), math.sin(heading)),
            (-math.sin(heading), math.cos(heading)),
        )
        self.disc(x, y, RADIUS_M, _ROBOT)
        tips = [(0.15, 0.0), (-0.08, 0.09), (-0.08, -0.09)]
        corners = [
            self._at(x + a * ahead[0] + b * left[0], y + a * ahead[1] + b * left[1])
            for a, b in tips
        ]
        self._draw.polygon(corners, (255, 255, 255))

    def cross(self, x: float, y: float) -> None:
        widths = max(2, round(0.15 * self._unit)), max(2, round(0.09 * self._unit))
        cross(self._draw, self._at(x, y), 0.2 * self._unit, _FAILED, widths)

    def flag(self, x: float, y: float, height: float) -> None:
        self.line(np.array([[x, y], [x, y + height]]), INK_RGB, 0.05)
        tip = [self._at(x + dx * height, y + dy * height) for dx, dy in _PENNANT]
        self._draw.polygon(tip, (255, 255, 255), INK_RGB)

    def text(self, x: float, y: float, text: str) -> None:
        self._draw.text(
            self._at(x, y),
            text,
            INK_RGB,
            font(0.75 * self._unit, bold=True),
            "mm",
            stroke_width=round(0.05 * self._unit),
            stroke_fill="white",
        )

    def finished(self) -> Image.Image:
        return self._picture.resize(self._size, Image.Resampling.BOX)
