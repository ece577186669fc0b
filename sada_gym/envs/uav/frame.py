"""Pictures of a rollout for people: the drone's camera image, and the track from above."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.uav.camera.pinhole import camera
from sada_gym.envs.uav.chase import from_behind
from sada_gym.envs.uav.episodes import RacingStart
from sada_gym.envs.uav.world.drone import heading_of
from sada_gym.envs.uav.world.gates import OUTER_WIDTH_M
from sada_gym.envs.uav.world.referee import GateOutcome
from sada_gym.envs.uav.world.track import line
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import INK_RGB, beside, caption, cross, dashed, font, stacked
from sada_gym.foundations.frames import (
    BLUE,
    GREEN,
    INK,
    VERMILLION,
    Colour,
    Frame,
    LegendEntry,
    rgb,
)

VIEW_ROWS, VIEW_COLUMNS = 384, 512
_MARGIN_M = 5.0
_FINER = 2
_CROSS = 9
"""Half the size of the cross where a drone hit something, in the finer picture's pixels."""
_SEEN_FROM_M, _IN_VIEW_DEG = 6.0, 30.0
"""A drone's picture is best taken at this distance from a gate, and with the gate within this angle
from the camera's axis."""

_FIELD, _LINE, _AHEAD = (226, 236, 214), (176, 190, 160), (107, 114, 128)
_FLOWN, _PASSED, _MISSED = rgb(BLUE), rgb(GREEN), rgb(VERMILLION)
_TEXT = 26

LEGEND = (
    LegendEntry("gate passed", GREEN, "line"),
    LegendEntry("gate missed", VERMILLION, "dashed line"),
    LegendEntry("way flown", BLUE, "line"),
    LegendEntry("line of the track", "#b0bea0", "dotted line"),
    LegendEntry("hit something here", INK, "cross"),
    LegendEntry("the drone at the time of the view", INK, "arrow"),
    LegendEntry(
        "Left: what the drone's camera sees before the first miss. Right: the track from above. "
        "After a miss the drone is set back into the last gate that it passed."
    ),
)


def summary(rollouts: Sequence[Rollout[RacingStart]]) -> Frame:
    """Draw the camera's picture where the first gate is missed (or half-way), beside the track."""
    (rollout,) = rollouts
    step, seen_at = shown_step(rollout)
    passed = int((rollout["endings"][-1] == GateOutcome.PASSED).sum())
    plan = _track_map(rollout, step, len(rollout["states"]))
    pair = beside(Image.fromarray(observation(rollout, step)), plan)
    text = (
        f"{passed} of {len(rollout.start.gates)} gates passed in {rollout['time_s'][-1]:.1f} s   "
        f"({_track(rollout)})\n{seen_at}"
    )
    return stacked([pair, caption(text, pair.width, _TEXT)])


def picture(rollouts: Sequence[Rollout[RacingStart]], i: int, step: int) -> tuple[Image.Image, str]:
    """Draw a decision of race i, the drone from behind beside the track, and describe it."""
    rollout = rollouts[i]
    state, endings = rollout["states"][step], rollout["endings"][step]
    passed = int((endings == GateOutcome.PASSED).sum())
    missed = int((endings > GateOutcome.PASSED).sum())
    ahead = len(endings) - passed - missed
    goal = f"to gate {passed + missed + 1}" if ahead else "over"
    text = (
        f"{rollout['time_s'][step]:4.1f} s   {np.linalg.norm(state[7:10]):4.1f} m/s   {goal}   "
        f"({_track(rollout)})\n{passed} gates passed   {missed} missed"
    )
    # a drone that has missed a gate was set back in the same decision
    is_back = missed > (rollout["endings"][max(0, step - 1)] > GateOutcome.PASSED).sum()
    seen = max(0, step - int(is_back))
    view = from_behind(rollout, seen, VIEW_ROWS, VIEW_COLUMNS)
    return beside(view, _track_map(rollout, seen, step + 1)), text


def shown_step(rollout: Rollout[RacingStart]) -> tuple[int, str]:
    """Choose the decision that the summary shows, and say which it is."""
    missed = rollout["endings"] > GateOutcome.PASSED
    if not missed.any():
        return len(rollout["states"]) // 2, "seen: half-way"
    late = int(missed.any(axis=1).argmax())
    gate = int(missed[late].argmax())
    since = int((rollout["endings"][:late, gate - 1] == GateOutcome.AHEAD).sum()) if gate else 0
    since = min(since, late - 1)  # both may have ended between two decisions
    flown = rollout["states"][since:late]
    centre, heading = rollout.start.gates[gate, :3], rollout.start.gates[gate, 3]
    to_gate = centre - flown[:, :3]
    before = to_gate[:, :2] @ [np.cos(heading), np.sin(heading)] > 0
    far = np.abs(np.sqrt((to_gate**2).sum(axis=1)) - _SEEN_FROM_M)
    lens = camera()
    places = np.concatenate([lens.project(state, centre[None]) for state in flown])
    off = np.hypot(*(places - [lens.columns / 2, lens.rows / 2]).T) * lens.pixel
    in_view = off < np.tan(np.deg2rad(_IN_VIEW_DEG))  # never behind the camera: NaN there
    if not (in_view & before).any():  # a drone that leans far may never have it in view
        far = np.nan_to_num(off, nan=np.inf)
    step = since + int(np.lexsort((far, ~in_view, ~before))[0])
    how = GateOutcome(int(rollout["endings"][late, gate])).name.lower()
    return step, f"seen: on the way to gate {gate + 1} ({how})"


def flown_ways(rollout: Rollout[RacingStart], until: int) -> tuple[Floats, ...]:
    """Return the ways flown, each to the place where a gate was missed and the drone set back."""
    missed = rollout["endings"][:until] > GateOutcome.PASSED
    cuts = np.flatnonzero(np.diff(missed.sum(axis=1))) + 1
    ways = np.split(rollout["states"][:until, :2], cuts)
    for way, cut in enumerate(cuts.tolist()):
        gate = int((missed[cut] & ~missed[cut - 1]).argmax())
        ways[way] = np.vstack([ways[way], rollout["ended_at"][cut, gate, :2]])
    return tuple(ways)


def _track_map(rollout: Rollout[RacingStart], step: int, until: int) -> Image.Image:
    state, endings = rollout["states"][step], rollout["endings"][until - 1]
    return TrackMap(rollout.start.gates, line(rollout.start.anchors)).picture(
        endings,
        flown_ways(rollout, until),
        np.array([*state[:2], heading_of(*state[3:7])]),
        rollout["ended_at"][until - 1, endings == GateOutcome.HIT, :2],
    )


def _track(rollout: Rollout[RacingStart]) -> str:
    return f"{len(rollout.start.anchors)} anchors"


def observation(rollout: Rollout[RacingStart], step: int = 0) -> Frame:
    """Draw what the drone's camera sees, large, after some steps."""
    start, states = rollout.start, rollout["states"][step : step + 1]
    frame: Frame
    (frame,) = camera(VIEW_ROWS, VIEW_COLUMNS).draw(start.gates[None], states, [start.seed])
    return frame


@dataclass(frozen=True)
class TrackMap:
    """A track from above, and where it lies in a square picture."""

    gates: Floats  # (g, 4) x, y, z and heading
    line: Floats  # (m, 2) the track's line
    size: int = VIEW_ROWS  # the number of pixels of the picture's side

    def picture(
        self,
        endings: npt.ArrayLike | None = None,
        flown: tuple[Floats, ...] = (),
        drone: Floats | None = None,
        hits: Floats | None = None,
    ) -> Image.Image:
        """Draw the track.

        `endings` (g,) are `GateOutcome`s, by default all ahead; `flown` the ways, (k, 2) each;
        `drone` its x, y and heading; `hits` (k, 2) where it hit something, marked by crosses.
        """
        side = self.size * _FINER
        picture = Image.new("RGB", (side, side), _FIELD)
        draw = ImageDraw.Draw(picture)
        closed = self._pixels(np.vstack([self.line, self.line[:1]]))
        dashed(draw, closed, _LINE, 6, 8, 8)
        for way in flown:
            draw.line(self._pixels(way), fill=_FLOWN, width=4)
        codes = np.zeros(len(self.gates), int) if endings is None else np.asarray(endings)
        face = font(19 * _FINER, bold=True)
        for number, (gate, code) in enumerate(zip(self.gates, codes.tolist(), strict=True), 1):
            colour = _AHEAD if code == GateOutcome.AHEAD else _MISSED
            colour = _PASSED if code == GateOutcome.PASSED else colour
            self._gate(draw, gate, colour, code)
            aside = gate[:2] + 3.2 * np.array([np.sin(gate[3]), -np.cos(gate[3])])
            (place,) = self._pixels(aside[None])
            draw.text(place, str(number), fill=colour, font=face, anchor="mm")
        for x, y in self._pixels(np.empty((0, 2)) if hits is None else hits):
            cross(draw, (x, y), _CROSS, INK_RGB, (14, 6))
        if drone is not None:
            self._drone(draw, drone)
        return picture.resize((self.size, self.size), Image.Resampling.LANCZOS)

    def _gate(self, draw: ImageDraw.ImageDraw, gate: Floats, colour: Colour, code: int) -> None:
        ahead = np.array([np.cos(gate[3]), np.sin(gate[3])])
        left = np.array([-ahead[1], ahead[0]]) * OUTER_WIDTH_M / 2
        ends = self._pixels(np.stack([gate[:2] + left, gate[:2] - left]))
        length = math.dist(*ends)
        dash, gap = (0.26 * length, 0.11 * length) if code > GateOutcome.PASSED else (length, 0.0)
        # thin, and never dashed, where ahead
        width = (2 if code == GateOutcome.AHEAD else 4) * _FINER
        dashed(draw, ends, colour, width, dash, gap)
        draw.line(self._pixels(np.stack([gate[:2], gate[:2] + 1.2 * ahead])), fill=colour, width=4)

    def _drone(self, draw: ImageDraw.ImageDraw, drone: Floats) -> None:
        turned = drone[2] + np.deg2rad([0, 140, 220])
        size = np.array([1.6, 1.3, 1.3]) * 7 * _FINER
        (x, y) = self._pixels(drone[None, :2])[0]
        corners = [
            (x + float(s * np.cos(a)), y - float(s * np.sin(a)))
            for s, a in zip(size, turned, strict=True)
        ]
        draw.polygon(corners, fill=INK_RGB, outline="white")

    def _pixels(self, points: Floats) -> list[tuple[float, float]]:
        all_points = np.vstack([self.gates[:, :2], self.line])
        low, high = all_points.min(axis=0) - _MARGIN_M, all_points.max(axis=0) + _MARGIN_M
        side = self.size * _FINER
        scale = side / float((high - low).max())
        off = (points - (low + high) / 2) * scale
        return [
            (float(np.clip(side / 2 + x, -side, 2 * side)), float(side / 2 - y)) for x, y in off
        ]
