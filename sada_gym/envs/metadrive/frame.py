"""Frames of drives for people: the road from above, around the car and as a whole."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.metadrive.start import PARAMETERS, POLICY_HZ, DriveEnd, DriveStart
from sada_gym.envs.metadrive.world.engine import LIDAR_M, RAYS
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import INK_RGB, caption, cross, ring, stacked
from sada_gym.foundations.frames import BLUE, VERMILLION, Colour, Frame, LegendEntry, rgb

WIDTH, HEIGHT, INSET = 700, 460, 200
_FINE = 2
"""Pictures are drawn larger by this factor and then made smaller, so that edges are smooth."""
_AROUND_M = 80.0
"""The metres that a picture is wide."""
_GRASS, _ROAD, _ROUTE, _EDGE = (214, 226, 208), (196, 200, 206), (172, 178, 188), (255, 255, 255)
_OWN, _CAR, _THING, _RETURN = rgb(BLUE), (226, 196, 60), (232, 106, 23), (220, 38, 38)
_LENGTH_M, _WIDTH_M = 4.515, 1.852
_TEXT = 17

LEGEND = (
    LegendEntry("lanes on the route", "#acb2bc", "area"),
    LegendEntry("other lanes", "#c4c8ce", "area"),
    LegendEntry("car that drives, its way", BLUE, "line"),
    LegendEntry("other cars", "#e2c43c", "square"),
    LegendEntry("cones, barriers, warnings", "#e86a17", "disc"),
    LegendEntry("what the lidar returns", "#dc2626", "dots"),
    LegendEntry("failed here", VERMILLION, "cross"),
    LegendEntry("In the corner: the whole road."),
)

Rollouts = Sequence[Rollout[DriveStart]]


def summary(rollouts: Rollouts) -> Frame:
    """Draw the end of the drive, with what happened and the conditions."""
    (rollout,) = rollouts
    values = rollout.start.conditions.values()
    lines = PARAMETERS.lines(values, 3)
    end = DriveEnd(int(rollout["ending"][-1])).words
    title = f"{end} after {rollout.last / POLICY_HZ:.1f} s, Q {rollout.score:.2f}"
    text = caption("\n".join([title, *lines]), WIDTH, _TEXT)
    return stacked([text, snapshot(rollout, rollout.last)])


def picture(rollouts: Rollouts, i: int, step: int) -> tuple[Image.Image, str]:
    """Draw a step of drive i, and say when that is."""
    done, speed = rollouts[i]["done"][step], rollouts[i]["pose"][step, 3]
    text = f"{step / POLICY_HZ:4.1f} s   {speed:2.0f} km/h   {done:4.0%} of the route"
    return snapshot(rollouts[i], step), text


def observation(rollout: Rollout[DriveStart], step: int = 0) -> Frame:
    """Draw the road around the car, and what its lidar returns, after some steps."""
    return draw_frame(rollout.start, {key: part[step] for key, part in rollout.snapshots.items()})


def draw_frame(start: DriveStart, now: Mapping[str, npt.NDArray[Any]]) -> Frame:
    """Draw what a snapshot of `DriveEpisodes` tells of one drive."""
    return np.asarray(_view(start, now, now["pose"][None, :2]))


def snapshot(rollout: Rollout[DriveStart], step: int) -> Image.Image:
    """Draw one step of a drive, with its way until then."""
    now = {key: part[step] for key, part in rollout.snapshots.items()}
    return _view(rollout.start, now, rollout["pose"][: step + 1, :2])


def _view(start: DriveStart, now: Mapping[str, npt.NDArray[Any]], way: Floats) -> Image.Image:
    near = _RoadMap((WIDTH, HEIGHT), now["pose"][:2], WIDTH / _AROUND_M, start)
    near.show(now, way, rays=True)
    corners = np.concatenate([outline for outline, _ in start.roads])
    low, high = corners.min(axis=0), corners.max(axis=0)
    unit = INSET / float((high - low).max() + 10.0)
    whole = _RoadMap((INSET, INSET), (low + high) / 2, unit, start)
    whole.show(now, way, rays=False)
    picture = near.finished()
    picture.paste(whole.finished(), (WIDTH - INSET, 0))
    ImageDraw.Draw(picture).rectangle((WIDTH - INSET, 0, WIDTH - 1, INSET), None, INK_RGB)
    return picture


class _RoadMap:
    """A map of a road around a point, `unit` pixels to the metre."""

    def __init__(
        self, size: tuple[int, int], middle: Floats, unit: float, start: DriveStart
    ) -> None:
        self._size, self._middle, self._unit = size, middle, _FINE * unit
        self._picture = Image.new("RGB", (_FINE * size[0], _FINE * size[1]), _GRASS)
        self._draw = ImageDraw.Draw(self._picture)
        for on_route in (False, True):
            for outline, is_route in start.roads:
                if is_route == on_route:
                    fill = _ROUTE if is_route else _ROAD
                    self._draw.polygon(self._at(outline), fill, _EDGE, max(1, int(0.15 * unit)))

    def _at(self, points: Floats) -> list[tuple[float, float]]:
        across, down = _FINE * self._size[0] / 2, _FINE * self._size[1] / 2
        moved = (points - self._middle) * self._unit
        return [(across + x, down - y) for x, y in moved.tolist()]

    def show(self, now: Mapping[str, npt.NDArray[Any]], way: Floats, *, rays: bool) -> None:
        """Draw the cars, what lies on the road, the way driven, and an end that is a failure."""
        x, y, heading, _ = now["pose"]
        if len(way) > 1:
            self._draw.line(self._at(way), _OWN, round(max(2.0 * _FINE, 0.3 * self._unit)), "curve")
        for other in now["cars"][np.isfinite(now["cars"][:, 0])].tolist():
            self._car(other, _CAR)
        for thing in now["things"][np.isfinite(now["things"][:, 0])]:
            self._dot(thing, max(3.0, 0.4 * self._unit), _THING)
        self._car([x, y, heading, _LENGTH_M, _WIDTH_M], _OWN)
        if rays:
            angles = heading + 2.0 * math.pi * np.arange(RAYS) / RAYS
            ends = np.stack([np.cos(angles), np.sin(angles)], axis=1)
            for end, share in zip(ends, now["rays"].tolist(), strict=True):
                if share < 1.0:
                    self._dot(np.array([x, y]) + LIDAR_M * share * end, 2.0 * _FINE, _RETURN)
        if now["ending"] > DriveEnd.ARRIVED:
            (middle,) = self._at(np.array([[x, y]]))
            if rays:
                ring(self._draw, *middle, 44 * _FINE)
            cross(self._draw, middle, 9 * _FINE, rgb(VERMILLION), (6 * _FINE, 3 * _FINE))

    def _car(self, body: Sequence[float], colour: Colour) -> None:
        x, y, heading, length, width = body
        ahead = np.array([math.cos(heading), math.sin(heading)]) * length / 2
        left = np.array([-math.sin(heading), math.cos(heading)]) * width / 2
        signs = ((1, 1), (1, -1), (-1, -1), (-1, 1))
        corners = np.array([[x, y] + a * ahead + b * left for a, b in signs])
        self._draw.polygon(self._at(corners), colour, INK_RGB, _FINE)
        front = np.array([[x, y] + 0.45 * ahead + b * 0.8 * left for b in (1, -1)])
        self._draw.line(self._at(front), INK_RGB, _FINE)

    def _dot(self, place: Floats, radius: float, colour: Colour) -> None:
        (middle,) = self._at(place[None])
        self._draw.circle(middle, radius, colour)

    def finished(self) -> Image.Image:
        """Return the map."""
        return self._picture.resize(self._size, Image.Resampling.BOX)
