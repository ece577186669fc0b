"""Races as shots: the drone seen from behind, and a map of the track."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw
from scipy.spatial.transform import Rotation

from sada_gym.arrays import Floats
from sada_gym.clips.captions import DONE, FAILED, INK, INSET, PAPER, WIDTH, add_inset, cross, ring
from sada_gym.clips.shots import Clip, Shot, ShotEnding, share_time, steps_before
from sada_gym.drawing import font
from sada_gym.envs.episodes.rollout import Rollout
from sada_gym.envs.uav.behaviour import missed
from sada_gym.envs.uav.camera.pinhole import TILT_DEG, DroneCamera, camera
from sada_gym.envs.uav.episodes import POLICY_HZ, RacingStart
from sada_gym.envs.uav.frame import flown_ways
from sada_gym.envs.uav.world.drone import ARM_X_M, ARM_Y_M, heading_of
from sada_gym.envs.uav.world.gates import OUTER_WIDTH_M, TOP_M
from sada_gym.envs.uav.world.referee import GateOutcome
from sada_gym.envs.uav.world.track import line
from sada_gym.frames import SKY, YELLOW, rgb
from sada_gym.parameters import Mu

if TYPE_CHECKING:
    from sada_gym.envs.uav.application import UAVApplication

ROWS = 270
SLOWER = 2
"""A race is shown so many times slower: the drone flies at up to 15 m/s."""
_BEHIND_M, _ABOVE_M, _DOWN_DEG = 1.5, 0.5, 12.0
"""Where the camera follows the drone, and by how much it looks down."""
_LAG = 4
"""The camera turns like the mean of so many decisions."""
_ROTOR_M = 0.075
_FINER, _MARGIN_M = 3, 4.0
_FIELD, _LINE, _AHEAD, _FLOWN = (226, 236, 214), (190, 203, 174), (107, 114, 128), rgb(SKY)
_FINE = 4
_ARROW = ((0.0, 26), (np.deg2rad(140), 20), (np.deg2rad(220), 20))
"""The drone on the map: the angles and the distances of a triangle's corners."""


def clip(application: UAVApplication, mu: Mu, seed: int, seconds: float) -> Clip:
    """Show how the drone missed the first gates that it missed, or the lap's end."""
    (rollout,) = application.rollouts(mu, seed)
    endings = rollout["endings"]
    gates = [int(gate) for gate in np.flatnonzero(endings[-1] > GateOutcome.PASSED)]
    moved = application.parameters.physical(mu).reshape(-1, 2)
    farthest_m = float(np.hypot(*moved.T).max())
    world = f"the track's {len(moved)} anchor points are moved by up to {farthest_m:.1f} m"
    if not gates:
        steps = _steps(0, len(endings) - 1, seconds)
        return Clip([_shot(rollout, steps, None, world)], rollout.score)
    ends = [int((endings[:, gate] > GateOutcome.PASSED).argmax()) for gate in gates]
    chosen, each_s = share_time(range(len(gates)), seconds)
    shots = []
    for k in chosen:
        # a drone that missed a gate was set back in the same decision
        begins = ends[k - 1] if k else 0
        steps = _steps(begins, ends[k] - 1, each_s)
        shots.append(_shot(rollout, steps, gates[k], world))
    return Clip(shots, rollout.score)


def _steps(first: int, last: int, seconds: float) -> range:
    kept = steps_before(last, seconds * POLICY_HZ / SLOWER)
    return range(max(min(first, last), kept[0]), last + 1)


def _shot(rollout: Rollout[RacingStart], steps: range, gate: int | None, world: str) -> Shot:
    states = [rollout["states"][step] for step in steps]
    times = [float(rollout["time_s"][step]) for step in steps]
    endings = [rollout["endings"][step] for step in steps]
    at = None
    if gate is not None:
        end = steps[-1] + 1
        at = rollout["ended_at"][end, gate]
        states.append(np.concatenate([at, states[-1][3:]]))
        times.append(float(rollout["time_s"][end]))
        endings.append(rollout["endings"][end])
    eyes, lens = _eyes(states), camera(ROWS, WIDTH)
    gates, count = rollout.start.gates, len(states)
    views = lens.draw(np.repeat(gates[None], count, 0), eyes, [rollout.start.seed] * count)
    pictures, notes = [], []
    for i, (view, state) in enumerate(zip(views, states, strict=True)):
        last = i == count - 1
        picture = Image.fromarray(view)
        coming = np.flatnonzero(endings[i] == GateOutcome.AHEAD)
        ahead = int(coming[0]) if len(coming) and not last else gate
        ahead = len(gates) - 1 if ahead is None else ahead
        _number(picture, lens, eyes[i], gates[ahead], ahead + 1)
        _drone(picture, lens, eyes[i], state)
        if last and at is not None:
            for x, y in lens.project(eyes[i], at[None]).tolist():
                ring(ImageDraw.Draw(picture), x, y, 30)
        until = steps[min(i, len(steps) - 1)] + 1
        ways = [way[:, :2] for way in flown_ways(rollout, until)]
        ways[-1] = np.vstack([ways[-1], state[None, :2]])
        track_map = _map(rollout.start, endings[i], ways, state, hit=at if last else None)
        add_inset(picture, track_map, Image.Resampling.LANCZOS)
        pictures.append(picture)
        speed = float(np.linalg.norm(state[7:10]))
        notes.append(
            f"to gate {ahead + 1} of {len(gates)}  ·  {times[i]:.1f} s  ·  {speed:.0f} m/s  ·  "
            "slow motion"
        )
    ending = _ending(rollout, gate, at, times[-1])
    return Shot(pictures, POLICY_HZ / SLOWER, notes, world, ending)


def _ending(
    rollout: Rollout[RacingStart], gate: int | None, at: Floats | None, time_s: float
) -> ShotEnding:
    gates = rollout.start.gates
    if gate is None or at is None:
        return ShotEnding(f"all {len(gates)} gates in {time_s:.1f} s", failed=False)
    outcome = int(rollout["endings"][-1][gate])
    return ShotEnding(missed(gates, gate, outcome, at), failed=True)


def _eyes(states: Sequence[Floats]) -> Floats:
    """Return the poses (n, 7) of a level camera that follows the drone."""
    headings = np.unwrap([float(heading_of(*state[3:7])) for state in states])
    padded = np.concatenate([np.full(_LAG - 1, headings[0]), headings])
    smooth = np.convolve(padded, np.full(_LAG, 1 / _LAG), mode="valid")
    places = np.stack([state[:3] for state in states])
    ahead = np.stack([np.cos(smooth), np.sin(smooth), np.zeros(len(smooth))], axis=1)
    eyes = places - _BEHIND_M * ahead + np.array([0.0, 0.0, _ABOVE_M])
    pitch = np.full(len(smooth), np.deg2rad(TILT_DEG + _DOWN_DEG))
    turned = Rotation.from_euler("ZY", np.stack([smooth, pitch], axis=1)).as_quat()
    return np.concatenate([eyes, turned], axis=1)


def _number(
    picture: Image.Image, lens: DroneCamera, eye: Floats, gate: Floats, number: int
) -> None:
    ((x, y),) = lens.project(eye, np.array([[gate[0], gate[1], TOP_M + 0.35]]))
    away = float(np.linalg.norm(gate[:2] - eye[:2]))
    size = float(np.clip(150 / max(away, 1.0), 13, 30))
    if 0 <= x < WIDTH:  # NaN where the gate is behind the camera
        draw = ImageDraw.Draw(picture)
        y = max(y, size + 4)  # a near gate is higher than the picture
        draw.text(
            (x, y),
            str(number),
            fill=PAPER,
            font=font(round(size), bold=True),
            anchor="mb",
            stroke_width=2,
            stroke_fill=INK,
        )


def _drone(picture: Image.Image, lens: DroneCamera, eye: Floats, state: Floats) -> None:
    """Draw the drone: a body, four arms, and rotors, of which the front ones are light."""
    turn = Rotation.from_quat(state[3:7])

    def seen(points: Floats) -> list[tuple[float, float]]:
        places = lens.project(eye, state[:3] + turn.apply(points))
        return [(float(x), float(y)) for x, y in _FINE * (places - corner)]

    reach = 2 * (ARM_X_M + _ROTOR_M)
    around = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]) * reach
    places = lens.project(eye, state[:3] + around)
    if not np.isfinite(places).all():
        return
    corner = np.floor(places.min(axis=0)).astype(int)
    width, height = (np.ceil(places.max(axis=0)).astype(int) - corner).tolist()
    if min(width, height) < 1 or max(width, height) > 2 * WIDTH:
        return
    finer = Image.new("RGBA", (_FINE * width, _FINE * height), (*INK, 0))
    draw = ImageDraw.Draw(finer)
    angles = np.linspace(0, 2 * np.pi, 25)[:-1]
    ring = _ROTOR_M * np.stack([np.cos(angles), np.sin(angles), np.zeros(24)], axis=1)
    body = np.array([[0.07, 0.035, 0], [0.07, -0.035, 0], [-0.07, -0.035, 0], [-0.07, 0.035, 0]])
    arms = np.array([[x, y, 0.0] for x in (ARM_X_M, -ARM_X_M) for y in (ARM_Y_M, -ARM_Y_M)])
    for x, y, _ in arms:
        draw.line(seen(np.array([[0, 0, 0], [x, y, 0.0]])), fill=(*INK, 255), width=3 * _FINE)
    for deck in (-0.02, 0.02):
        draw.polygon(seen(body + np.array([0, 0, deck])), fill=(*INK, 255), outline=(*PAPER, 255))
    for x, y, _ in arms:
        colour = rgb(YELLOW) if x > 0 else (220, 226, 232)
        rotor = seen(ring + np.array([x, y, 0.03]))
        draw.polygon(rotor, fill=(*colour, 150))
        draw.line([*rotor, rotor[0]], fill=(*INK, 255), width=_FINE)
    small = finer.resize((width, height), Image.Resampling.BOX)
    picture.paste(small, (int(corner[0]), int(corner[1])), small)


def _map(
    start: RacingStart,
    endings: npt.NDArray[np.int8],
    ways: Sequence[Floats],
    state: Floats,
    hit: Floats | None,
) -> Image.Image:
    """Draw the track from above: gates ahead, passed (blue) and missed (orange), and the drone."""
    side = INSET * _FINER
    track = line(start.anchors)
    points = np.vstack([start.gates[:, :2], track])
    low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
    scale = side / float((high - low).max())

    def pixels(places: Floats) -> list[tuple[float, float]]:
        off = (places - (low + high) / 2) * scale
        return [(float(side / 2 + x), float(side / 2 - y)) for x, y in off]

    picture = Image.new("RGB", (side, side), _FIELD)
    draw = ImageDraw.Draw(picture)
    draw.line(pixels(np.vstack([track, track[:1]])), fill=_LINE, width=6)
    for way in ways:
        draw.line(pixels(way), fill=_FLOWN, width=6, joint="curve")
    for gate, code in zip(start.gates, endings.tolist(), strict=True):
        colour = {GateOutcome.AHEAD: _AHEAD, GateOutcome.PASSED: DONE}.get(code, FAILED)
        left = np.array([-np.sin(gate[3]), np.cos(gate[3])]) * OUTER_WIDTH_M * 0.7
        draw.line(pixels(np.stack([gate[:2] - left, gate[:2] + left])), fill=colour, width=11)
    heading = float(heading_of(*state[3:7]))
    ((x, y),) = pixels(state[None, :2])
    tip = [(x + s * np.cos(heading + a), y - s * np.sin(heading + a)) for a, s in _ARROW]
    draw.polygon(tip, fill=INK, outline=PAPER, width=3)
    if hit is not None:
        ((x, y),) = pixels(hit[None, :2])
        cross(draw, x, y, 17)
    return picture
