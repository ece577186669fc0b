"""Drives as shots: what the camera sees, and a map of the streets around the car."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.arrays import Bytes, Floats
from sada_gym.clips.captions import FAILED, INK, INSET, PAPER, WIDTH, add_inset, cross
from sada_gym.clips.shots import Clip, Shot, ShotEnding, clip_failures, steps_before
from sada_gym.envs.driving.camera.pinhole import Lens, camera
from sada_gym.envs.driving.episodes import POLICY_HZ, DrivingEnd, DrivingStart
from sada_gym.envs.driving.frame import town_plan  # the whole town from above
from sada_gym.envs.driving.world.route import COMMANDS, LAYOUT
from sada_gym.envs.driving.world.vehicle import LENGTH_M, WIDTH_M
from sada_gym.envs.driving.world.weather import NAMES
from sada_gym.envs.episodes.rollout import Rollout
from sada_gym.frames import SKY, YELLOW, rgb
from sada_gym.parameters import Mu, number

if TYPE_CHECKING:
    from sada_gym.envs.driving.application import DrivingApplication

ROWS = 270
_BETWEEN = 2
"""Pictures for each step of the driver; the places between two steps are interpolated."""
_SPAN_M, _FINER = 62.0, 3
_WAY, _DRIVEN = rgb(YELLOW), rgb(SKY)
_COMMANDS = {
    "follow": "follow the road",
    "left": "turn left",
    "right": "turn right",
    "straight": "straight on",
}


def clip(application: DrivingApplication, mu: Mu, seed: int, seconds: float) -> Clip:
    """Show how the drives that failed ended."""
    rollouts = application.rollouts(mu, seed)

    def shot(i: int, seconds: float) -> Shot:
        return _shot(rollouts[i], f"route {i + 1} of {len(rollouts)}", seconds)

    score = np.array([rollout.score for rollout in rollouts])
    return clip_failures(score, score < 1, seconds, shot)


def _shot(rollout: Rollout[DrivingStart], name: str, seconds: float) -> Shot:
    states, last = rollout["states"], len(rollout["states"]) - 1
    steps = steps_before(last, seconds * POLICY_HZ)
    moments = np.linspace(steps[0], last, (len(steps) - 1) * _BETWEEN + 1)
    places = np.stack([np.interp(moments, np.arange(last + 1), column) for column in states.T], 1)
    views = _views(rollout.start, places, moments)
    ending = DrivingEnd(int(rollout["ending"][-1]))
    pictures, notes = [], []
    for i, (view, place, moment) in enumerate(zip(views, places, moments, strict=True)):
        driven = np.vstack([states[: int(moment) + 1, :2], place[None, :2]])
        picture = Image.fromarray(view)
        over = i == len(places) - 1 and ending != DrivingEnd.ARRIVED
        street_map = _map(rollout.start, place, driven, failed=over)
        add_inset(picture, street_map, Image.Resampling.BOX)
        pictures.append(picture)
        command = _COMMANDS[COMMANDS[int(rollout["command"][int(moment)])]]
        time_s, speed_km_h = moment / POLICY_HZ, 3.6 * place[3]
        notes.append(f"{name}  ·  {time_s:.1f} s  ·  {speed_km_h:.0f} km/h  ·  told: {command}")
    mount = rollout.start.mount
    world = (
        f"{_weather(rollout.start.weather)}; camera {mount.height_m:.2f} m high, pitch "
        f"{number(mount.pitch_deg)}°"
    )
    shot_ending = _ending(ending, last / POLICY_HZ, _side(rollout))
    return Shot(pictures, POLICY_HZ * _BETWEEN, notes, world, shot_ending)


def _side(rollout: Rollout[DrivingStart]) -> str:
    # y points to the right of x
    route, place = rollout.start.route, rollout["states"][-1, :2]
    off = place - route.points
    nearest = int((off**2).sum(axis=1).argmin())
    heading = route.heading[nearest]
    right = -np.sin(heading) * off[nearest, 0] + np.cos(heading) * off[nearest, 1]
    return "right" if right > 0 else "left"


def _ending(ending: DrivingEnd, after_s: float, side: str) -> ShotEnding:
    texts = {
        DrivingEnd.ARRIVED: f"arrived after {after_s:.0f} s",
        DrivingEnd.LEFT_LANE: f"left its lane on the {side} after {after_s:.1f} s",
        DrivingEnd.TOO_LATE: f"not there after {after_s:.0f} s",
    }
    return ShotEnding(texts[ending], ending != DrivingEnd.ARRIVED)


def _weather(index: int) -> str:
    return "".join(f" {c.lower()}" if c.isupper() else c for c in NAMES[index]).strip()


def _views(start: DrivingStart, places: Floats, moments: Floats) -> Bytes:
    """Draw what the camera sees from places (n, 4), at some steps of the driver, (n,)."""
    count, lens = len(places), Lens(ROWS, WIDTH)
    poses = np.column_stack([places[:, :3], np.full(count, start.mount.height_m)])
    keys = np.round(moments * _BETWEEN).astype(np.uint64) + np.uint64(start.seed * (1 << 20))
    rays = lens.rays(start.mount.pitch_deg)[None]
    mounts, weathers = np.zeros(count, np.int64), np.full(count, start.weather, np.int64)
    return camera(LAYOUT).draw(lens, rays, mounts, poses, weathers, keys)


def _map(start: DrivingStart, place: Floats, driven: Floats, *, failed: bool) -> Image.Image:
    """Draw the streets around the car from above, its route, and the way that it drove."""
    side = INSET * _FINER
    chart = _town()
    half = _SPAN_M / 2 / chart.pixel_m
    ((x, y),) = chart.pixels(place[None, :2])
    box = (x - half, y - half, x + half, y + half)
    picture: Image.Image = chart.picture.transform(
        (side, side), Image.Transform.EXTENT, box, Image.Resampling.BICUBIC, fillcolor=(60, 80, 50)
    )
    draw, unit = ImageDraw.Draw(picture), side / _SPAN_M

    def pixels(points: Floats) -> list[tuple[float, float]]:
        return [
            (side / 2 + unit * float(dx), side / 2 + unit * float(dy))
            for dx, dy in points - place[:2]
        ]

    draw.line(pixels(start.route.points), fill=_WAY, width=round(0.9 * unit), joint="curve")
    draw.line(pixels(driven), fill=_DRIVEN, width=round(0.9 * unit), joint="curve")
    forward = np.array([np.cos(place[2]), np.sin(place[2])])
    left = np.array([-forward[1], forward[0]])
    corners = [(1, 1), (1, -1), (-1, -1), (-1, 1)]
    car = np.array([a * LENGTH_M / 2 * forward + b * WIDTH_M / 2 * left for a, b in corners])
    draw.polygon(
        pixels(place[:2] + 1.25 * car), fill=FAILED if failed else INK, outline=PAPER, width=5
    )
    if failed:
        cross(draw, side / 2, side / 2, 2.4 * unit)
    return picture


@cache
def _town() -> Any:
    return town_plan(camera(LAYOUT))
