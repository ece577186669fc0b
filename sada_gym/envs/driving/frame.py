"""Pictures of a rollout for people: the camera's image, and a map with the driven way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.envs.driving.camera.pinhole import Lens, TownCamera, camera
from sada_gym.envs.driving.camera.scenery import BUILDING
from sada_gym.envs.driving.episodes import POLICY_HZ, DrivingStart
from sada_gym.envs.driving.world.route import COMMANDS, LAYOUT
from sada_gym.envs.driving.world.town import town
from sada_gym.envs.driving.world.weather import NAMES
from sada_gym.envs.episodes.base import Rollout
from sada_gym.foundations.arrays import Floats, Floats32
from sada_gym.foundations.drawing import INK_RGB, caption, cross, dashed, font, inset, stacked
from sada_gym.foundations.frames import BLUE, GREEN, VERMILLION, YELLOW, Frame, LegendEntry, rgb

_LENS, _FILM_LENS = Lens(198, 450), Lens(270, 480)
_INSET = 170
_MAP_LEVEL = 2
_EDGE_M = 22.0
_ROUTE, _DRIVEN, _FAILED, _GOAL = rgb(YELLOW), rgb(BLUE), rgb(VERMILLION), rgb(GREEN)
_TEXT = 20
Rollouts = Sequence[Rollout[DrivingStart]]

LEGEND = (
    LegendEntry("route", YELLOW, "line"),
    LegendEntry("way driven", BLUE, "dashed line"),
    LegendEntry("start", "#ffffff", "disc"),
    LegendEntry("goal", GREEN, "square"),
    LegendEntry("failed here", VERMILLION, "cross"),
    LegendEntry(
        "Above: what the camera sees, on the first route that failed. Below: the town from above "
        "with all five routes. Beside the weather stand the camera's height and pitch."
    ),
)


def summary(rollouts: Rollouts) -> Frame:
    """Draw the camera's image where a drive fails (or half-way), above a map of all drives."""
    failed = [i for i, rollout in enumerate(rollouts) if rollout.score < 1]
    which = failed[0] if failed else 0
    last = len(rollouts[which]["states"]) - 1
    step = max(0, last - POLICY_HZ) if failed else last // 2
    image = Image.fromarray(observation(rollouts[which], step))
    arrived = len(rollouts) - len(failed)
    title = f"{_world(rollouts)}\n{arrived} of {len(rollouts)} routes driven to the goal"
    seen_at = "a second before it failed" if failed else "half-way"
    parts = [
        caption(title, image.width, _TEXT),
        image,
        _map(_town_map(image.width), dict(enumerate(rollouts))),
        caption(f"seen: route {which + 1}, {seen_at}", image.width, _TEXT),
    ]
    return stacked(parts)


def picture(rollouts: Rollouts, i: int, step: int) -> tuple[Image.Image, str]:
    """Draw a step of drive i, the camera's image with a map in its corner, and describe it."""
    rollout = rollouts[i]
    image = Image.fromarray(observation(rollout, step, _FILM_LENS))
    inset(image, _map(_town_map(_INSET), {i: rollout}, until=step))
    command = COMMANDS[rollout["command"][step]]
    speed_km_h = 3.6 * rollout["states"][step, 3]
    text = (
        f"route {i + 1} of {len(rollouts)}   {step / POLICY_HZ:4.1f} s   {speed_km_h:3.0f} km/h   "
        f"command: {command}\n{_world(rollouts)}"
    )
    return image, text


def observation(rollout: Rollout[DrivingStart], step: int = 0, lens: Lens = _LENS) -> Frame:
    """Draw the camera's image, large, after some steps."""
    start = rollout.start
    pose = np.array([[*rollout["states"][step, :3], start.mount.height_m]])
    key = np.array([start.seed * (1 << 20) + step], np.uint64)
    rays, weather = _rays(lens, start.mount.pitch_deg)[None], np.array([start.weather])
    frame: Frame
    (frame,) = camera(LAYOUT).draw(lens, rays, np.zeros(1, np.int64), pose, weather, key)
    return frame


@lru_cache(maxsize=2)
def _rays(lens: Lens, pitch_deg: float) -> Floats32:
    return lens.rays(pitch_deg)


def _world(rollouts: Rollouts) -> str:
    start = rollouts[0].start
    height, pitch = start.mount.height_m, start.mount.pitch_deg
    return f"{NAMES[start.weather]}, {height:.2f} m, {pitch:.1f}°"


def _map(
    town_map: _TownMap, rollouts: Mapping[int, Rollout[DrivingStart]], until: int | None = None
) -> Image.Image:
    picture = town_map.picture.copy()
    draw, unit = ImageDraw.Draw(picture), town_map.picture.width / 100
    face = font(4.6 * unit, bold=True)
    routes = {i: town_map.pixels(rollout.start.route.points) for i, rollout in rollouts.items()}
    shown = slice(None if until is None else until + 1)
    ways = {i: town_map.pixels(rollout["states"][shown, :2]) for i, rollout in rollouts.items()}
    for route in routes.values():
        draw.line(route, fill=_ROUTE, width=max(3, round(1.5 * unit)))
    for way in ways.values():
        width = max(2, round(0.7 * unit))
        dashed(draw, way, _DRIVEN, width, 3 * unit, 1.2 * unit)
    for i, route in routes.items():
        draw.circle(route[0], 1.3 * unit, (255, 255, 255), INK_RGB)
        x, y = route[-1]
        draw.rectangle(
            (x - 1.3 * unit, y - 1.3 * unit, x + 1.3 * unit, y + 1.3 * unit), _GOAL, INK_RGB
        )
        for x, y in (route[0], route[-1]) if len(routes) > 1 else ():
            draw.text(
                (x + 3 * unit, y - 3 * unit),
                str(i + 1),
                fill=INK_RGB,
                font=face,
                anchor="mm",
                stroke_width=round(0.4 * unit),
                stroke_fill="white",
            )
    for i, way in ways.items():
        x, y = way[-1]
        over = len(way) == len(rollouts[i]["states"])
        if over and rollouts[i].score < 1:
            widths = max(4, round(2 * unit)), max(2, round(unit))
            cross(draw, (x, y), 2.2 * unit, _FAILED, widths)
        elif not over:
            draw.circle((x, y), 1.3 * unit, _DRIVEN, INK_RGB)
    return picture


@dataclass(frozen=True)
class _TownMap:
    """The town from above; `corner` is the place of its upper left corner in the world."""

    picture: Image.Image
    corner: Floats
    pixel_m: float

    def pixels(self, points: Floats) -> list[tuple[float, float]]:
        return [(float(x), float(y)) for x, y in (points - self.corner) / self.pixel_m]


@cache
def _town_map(width: int) -> _TownMap:
    whole = _town_plan(camera(LAYOUT))
    texel = whole.pixel_m
    corners = np.array(list(town(LAYOUT).layout.corners.values()), float)
    low = np.floor((corners.min(axis=0) - _EDGE_M - whole.corner) / texel)
    high = np.floor((corners.max(axis=0) + _EDGE_M - whole.corner) / texel)
    part = whole.picture.crop((*low.astype(int), *high.astype(int)))
    shown = part.resize((width, round(part.height * width / part.width)), Image.Resampling.BOX)
    return _TownMap(shown, whole.corner + low * texel, texel * part.width / width)


def _town_plan(town_camera: TownCamera) -> _TownMap:
    """Draw the ground with the buildings' roofs and the trees."""
    picture = Image.fromarray(town_camera.plan(_MAP_LEVEL).copy())
    plan = _TownMap(picture, town_camera.ground.origin, town_camera.ground.texel_m * 2**_MAP_LEVEL)
    draw = ImageDraw.Draw(picture)
    for kind, x, y, ax, ay, length, width, _, *colour, _ in town_camera.scenery.objects:
        fill = tuple(int(255 * np.sqrt(0.8 * c)) for c in colour)
        if kind == BUILDING:
            axis, across = np.array([ax, ay]), np.array([-ay, ax])
            signs = ((1, 1), (1, -1), (-1, -1), (-1, 1))
            corners = np.array([(x, y) + u * length * axis + v * width * across for u, v in signs])
            draw.polygon(plan.pixels(corners), fill=fill)
        else:
            round_it = np.array([[x - length, y - length], [x + length, y + length]])
            draw.ellipse(plan.pixels(round_it), fill=fill)
    return plan
