"""Pictures of a walk for people: the robot dog from the side, above a map of its way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.go2.package import package, turned
from sada_gym.envs.go2.start import PARAMETERS, POLICY_HZ, PUSH_S, Go2Start, WalkEnd
from sada_gym.envs.go2.world.robot import LOAD_M
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import INK_RGB, caption, cross, dashed, ring, stacked
from sada_gym.foundations.frames import BLUE, ORANGE, VERMILLION, Frame, LegendEntry, rgb

WIDTH, HEIGHT, MAP = 700, 380, 130
_FINE = 2
"""Pictures are drawn larger by this factor and then made smaller, so that edges are smooth."""
_SKY, _GROUND, _GRID, _SHADE = (236, 241, 246), (219, 222, 214), (192, 197, 186), (158, 163, 152)
_TOP, _RISER, _SIDE = (206, 196, 176), (166, 154, 130), (182, 171, 148)
_WAY, _WALKED, _LOAD = (110, 118, 128), rgb(BLUE), rgb(ORANGE)
_FAILED, _PUSH = rgb(VERMILLION), rgb(VERMILLION)
_TURNED, _RAISED = math.radians(28.0), math.radians(17.0)
"""The view's direction: from the right and a little ahead, and from above."""
_METRE, _HALF_M, _AROUND_M = 270.0, 0.8, 3.0
"""A metre's pixels; half the width of steps as drawn; how far the ground is drawn."""
_LIGHT = np.array([0.35, -0.55, 0.76])
_FULL_KG, _BACK_M = 8.0, 0.057
"""The load that fills its box, and how high the trunk's back is above its middle."""
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 24)
_TEXT = 17

LEGEND = (
    LegendEntry("commanded way", "#6e7680", "dashed line"),
    LegendEntry("way walked", BLUE, "line"),
    LegendEntry("push", VERMILLION, "arrow"),
    LegendEntry("load", ORANGE, "square"),
    LegendEntry("failed here", VERMILLION, "cross"),
    LegendEntry("Below: the way from above; the darker a slab of the ground, the higher it is."),
    LegendEntry("Slabs are as wide as the ground; they are drawn up to 0.8 m beside the robot."),
)


def summary(rollouts: Sequence[Rollout[Go2Start]]) -> Frame:
    """Draw the end of the walk, with what happened and the conditions."""
    (rollout,) = rollouts
    values = rollout.start.conditions.values()
    lines = PARAMETERS.lines(values, 4)
    done, _, end = rollout["told"][-1].tolist()
    fell = ", then it fell" if end > WalkEnd.WALKED else ""
    title = f"{done:.0%} of the way done in {rollout.last / POLICY_HZ:.1f} s{fell}"
    text = caption("\n".join([title, *lines]), WIDTH, _TEXT)
    return stacked([text, snapshot(rollout, rollout.last)])


def picture(rollouts: Sequence[Rollout[Go2Start]], i: int, step: int) -> tuple[Image.Image, str]:
    """Draw a step of walk i, and say when that is."""
    done = rollouts[i]["told"][step, 0]
    pushed = "   pushed" if _pushed(rollouts[i].start, step) else ""
    text = f"{step / POLICY_HZ:4.1f} s   {done:.0%} of the way done{pushed}"
    return snapshot(rollouts[i], step), text


def observation(rollout: Rollout[Go2Start], step: int = 0) -> Frame:
    """Draw the robot and the ground after some steps."""
    return draw_frame(rollout.start, rollout["parts"][step])


def draw_frame(start: Go2Start, parts: Floats) -> Frame:
    """Draw a robot whose bodies are somewhere, (13, 7): see `Go2Episodes`."""
    return np.asarray(_Scene(start, parts).finished())


def snapshot(rollout: Rollout[Go2Start], step: int) -> Image.Image:
    """Draw a step of a walk, above a map of the way until then."""
    start, parts = rollout.start, rollout["parts"][: step + 1]
    scene = _Scene(start, parts[-1])
    if _pushed(start, step):
        scene.push(parts[-1, 0, :3])
    failed = rollout["told"][step, 2] > WalkEnd.WALKED
    if failed:
        scene.failed(parts[-1, 0, :3])
    return Image.fromarray(stacked([scene.finished(), _map(start, parts[:, 0, :2], failed=failed)]))


def _pushed(start: Go2Start, step: int) -> bool:
    """Say whether a push is worth showing: it is drawn twice as long as it lasts."""
    first = start.push_at
    lasts = first <= step < first + 2 * round(PUSH_S * POLICY_HZ)
    return lasts and start.conditions["push_m_s"] > 0.05


def _map(start: Go2Start, walked: Floats, *, failed: bool) -> Image.Image:
    """Draw the way from above: the commanded one, and the one walked, (k, 2)."""
    drawn = Image.new("RGB", (WIDTH * _FINE, MAP * _FINE), "white")
    draw = ImageDraw.Draw(drawn)
    both = np.concatenate([start.way[:, :2], walked])
    low, high = both.min(axis=0) - 0.3, both.max(axis=0) + 0.3
    scale = min(WIDTH / max(high[0] - low[0], 6.5), MAP / max(high[1] - low[1], 1.2)) * _FINE
    middle = (low + high) / 2

    def at(points: Floats) -> list[tuple[float, float]]:
        x = WIDTH * _FINE / 2 + scale * (points[:, 0] - middle[0])
        y = MAP * _FINE / 2 - scale * (points[:, 1] - middle[1])
        return list(zip(x.tolist(), y.tolist(), strict=True))

    most = PARAMETERS.parameters[PARAMETERS.names.index("step_height_m")].high
    for near, far, height in start.slabs:
        (left, _), (right, _) = at(np.array([[near, 0.0], [far, 0.0]]))
        colour = tuple(round(255 - (255 - part) * height / most) for part in _RISER)
        draw.rectangle((left, 0, right, MAP * _FINE), colour)
    dashed(draw, at(start.way[:, :2]), _WAY, 2 * _FINE, 12, 9)
    places = at(walked)
    draw.line(places, _WALKED, 3 * _FINE, joint="curve")
    draw.circle(places[0], 4 * _FINE, "white", INK_RGB, _FINE)
    if len(walked) > start.push_at and start.conditions["push_m_s"] > 0.05:
        x, y = places[start.push_at]
        direction = math.radians(start.conditions["push_direction_deg"])
        ahead = np.array([math.cos(direction), -math.sin(direction)])
        _arrow(draw, np.array([x, y]) - 34 * _FINE * ahead, np.array([x, y]) - 4 * _FINE * ahead)
    if failed:
        cross(draw, places[-1], 9 * _FINE, _FAILED, (6 * _FINE, 3 * _FINE))
    draw.rectangle((0, 0, WIDTH * _FINE - 1, MAP * _FINE - 1), outline=_GRID, width=_FINE)
    return drawn.resize((WIDTH, MAP), Image.Resampling.BOX)


def _arrow(draw: ImageDraw.ImageDraw, tail: Floats, tip: Floats) -> None:
    along = (tip - tail) / math.dist(tip, tail)
    across = np.array([-along[1], along[0]])
    neck = tip - 11 * _FINE * along
    draw.line([*map(tuple, (tail, neck))], _PUSH, 5 * _FINE)
    head = [tip, neck + 8 * _FINE * across, neck - 8 * _FINE * across]
    draw.polygon([*map(tuple, head)], _PUSH, INK_RGB)


@lru_cache(maxsize=16)
def _mesh(payload_kg: float, ahead_m: float, left_m: float) -> tuple[Any, ...]:
    """Return the robot's mesh with its load: vertices, their bodies, faces and colours."""
    import trimesh

    robot = package()
    size = np.array(LOAD_M) * (payload_kg / _FULL_KG) ** (1.0 / 3.0)
    box: Any = trimesh.creation.box(np.maximum(size, 1e-6))
    vertices = np.add(box.vertices, [ahead_m, left_m, _BACK_M + size[2] / 2])
    return (
        np.concatenate([robot.vertices, vertices]),
        np.concatenate([robot.body_of, np.zeros(len(vertices), np.int64)]),
        np.concatenate([robot.faces, box.faces + len(robot.vertices)]),
        np.concatenate([robot.colours, np.tile(_LOAD, (len(box.faces), 1))]),
    )


class _Scene:
    """A view of the robot from the side, on its piece of ground; gravity points down."""

    def __init__(self, start: Go2Start, parts: Floats) -> None:
        self._picture = Image.new("RGB", (WIDTH * _FINE, HEIGHT * _FINE), _SKY)
        self._draw = ImageDraw.Draw(self._picture)
        self._slope = math.radians(start.conditions["slope_deg"])
        self._start, self._middle = start, parts[0, :3] * [1, 1, 0]
        self._ground()
        self._shadow(parts)
        self._robot(parts)

    def _turned(self, points: Floats) -> Floats:
        """Return points (k, 3) as seen: to the right, up and towards the viewer, in m."""
        x, y, z = (points - self._middle).T
        ahead = x * math.cos(self._slope) - z * math.sin(self._slope)
        up = x * math.sin(self._slope) + z * math.cos(self._slope)
        right = ahead * math.cos(_TURNED) + y * math.sin(_TURNED)
        near = ahead * math.sin(_TURNED) - y * math.cos(_TURNED)
        cosine, sine = math.cos(_RAISED), math.sin(_RAISED)
        return np.stack([right, up * cosine - near * sine, up * sine + near * cosine], axis=1)

    def _pixels(self, seen: Floats) -> Floats:
        across = _FINE * (WIDTH / 2 + _METRE * seen[:, 0])
        return np.stack([across, _FINE * (0.66 * HEIGHT - _METRE * seen[:, 1])], axis=1)

    def _at(self, points: Any) -> list[tuple[float, float]]:
        return [*map(tuple, self._pixels(self._turned(np.asarray(points, float))).tolist())]

    def _ground(self) -> None:
        x0, y0, _ = np.round(self._middle)
        reach = _AROUND_M + 1.0
        corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
        self._draw.polygon(self._at([x0, y0, 0] + reach * np.array(corners)), _GROUND)
        for k in np.arange(-reach, reach + 0.1, 0.5).tolist():
            for ends in (
                [[x0 + k, y0 - reach, 0.0], [x0 + k, y0 + reach, 0.0]],
                [[x0 - reach, y0 + k, 0.0], [x0 + reach, y0 + k, 0.0]],
            ):
                self._draw.line(self._at(ends), _GRID, _FINE)
        right, left, before = self._middle[1] - _HALF_M, self._middle[1] + _HALF_M, 0.0
        steps = self._start.slabs if self._start.conditions["step_height_m"] > 0.0 else ()
        for near, far, top in steps:
            if abs((near + far) / 2 - x0) < _AROUND_M:
                side = [(near, right, 0), (far, right, 0), (far, right, top), (near, right, top)]
                self._draw.polygon(self._at(side), _SIDE, _RISER)
                tread = [(near, right, top), (far, right, top), (far, left, top), (near, left, top)]
                self._draw.polygon(self._at(tread), _TOP, _RISER)
                if before > top:  # the viewer stands ahead, and sees what goes down
                    rise = [(near, y, z) for y, z in ((right, top), (left, top), (left, before))]
                    self._draw.polygon(self._at([*rise, (near, right, before)]), _RISER)
            before = top

    def _height(self, x: float) -> float:
        return next((top for near, far, top in self._start.slabs if near <= x < far), 0.0)

    def _shadow(self, parts: Floats) -> None:
        x, y, _, w, i, j, k = parts[0].tolist()
        heading = math.atan2(2 * (i * j + w * k), 1 - 2 * (j * j + k * k))
        along, across = 0.36 * np.cos(_CIRCLE), 0.17 * np.sin(_CIRCLE)
        rim_x = x + along * math.cos(heading) - across * math.sin(heading)
        rim_y = y + along * math.sin(heading) + across * math.cos(heading)
        heights = [self._height(place) for place in rim_x.tolist()]
        self._draw.polygon(self._at(np.stack([rim_x, rim_y, heights], axis=1)), _SHADE)

    def _robot(self, parts: Floats) -> None:
        names = ("payload_kg", "payload_ahead_m", "payload_left_m")
        load = (self._start.conditions[name] for name in names)
        vertices, body_of, faces, colours = _mesh(*load)
        points = parts[body_of, :3] + turned(parts[body_of, 3:], vertices)
        seen = self._turned(points)
        corners, flat = points[faces], self._pixels(seen)[faces]
        (ux, uy), (vx, vy) = (flat[:, 1] - flat[:, 0]).T, (flat[:, 2] - flat[:, 0]).T
        shown = np.flatnonzero(ux * vy - uy * vx < 0.0)
        order = shown[np.argsort(seen[faces[shown], 2].mean(axis=1), kind="stable")]
        first, second, third = corners[order].transpose(1, 0, 2)
        normals = np.cross(second - first, third - first)
        normals /= np.sqrt((normals**2).sum(axis=1, keepdims=True)) + 1e-12
        light = 0.5 + 0.5 * (normals * _LIGHT).sum(axis=1).clip(0.0, 1.0)
        shades = np.rint(colours[order] * light[:, None]).astype(int).tolist()
        for triangle, colour in zip(flat[order].reshape(-1, 6).tolist(), shades, strict=True):
            self._draw.polygon(triangle, tuple(colour))

    def push(self, place: Floats) -> None:
        """Draw a push against the trunk."""
        now = self._start.conditions
        direction = math.radians(now["push_direction_deg"])
        ahead = np.array([math.cos(direction), math.sin(direction), 0.0])
        reach = 0.25 + 0.2 * now["push_m_s"]
        tail, tip = np.array(self._at([place - (0.15 + reach) * ahead, place - 0.15 * ahead]))
        _arrow(self._draw, tail, tip)

    def failed(self, place: Floats) -> None:
        """Mark where the robot fell."""
        (middle,) = self._at(place[None])
        ring(self._draw, *middle, 60 * _FINE)

    def finished(self) -> Image.Image:
        """Return the picture in its own size."""
        return self._picture.resize((WIDTH, HEIGHT), Image.Resampling.BOX)
