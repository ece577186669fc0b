"""The drone as a camera sees it that follows it."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial.transform import Rotation

from sada_gym.envs.episodes.base import Rollout
from sada_gym.envs.uav.camera.pinhole import TILT_DEG, DroneCamera, camera
from sada_gym.envs.uav.episodes import RacingStart
from sada_gym.envs.uav.world.drone import ARM_X_M, ARM_Y_M, heading_of
from sada_gym.envs.uav.world.gates import TOP_M
from sada_gym.envs.uav.world.referee import GateOutcome
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import INK_RGB, font
from sada_gym.foundations.frames import YELLOW, rgb

_BEHIND_M, _ABOVE_M, _DOWN_DEG = 1.5, 0.5, 12.0
"""Where the camera follows the drone, and by how much it looks down."""
_LAG = 4
"""The camera turns like the mean of so many decisions."""
_ROTOR_M = 0.075
_FINE = 4
_WHITE = (255, 255, 255)


def from_behind(rollout: Rollout[RacingStart], step: int, rows: int, columns: int) -> Image.Image:
    """Draw the drone after some decisions, with the number of the gate ahead."""
    states, gates = rollout["states"][max(0, step + 1 - _LAG) : step + 1], rollout.start.gates
    eye, lens = _eye(states), camera(rows, columns)
    (view,) = lens.draw(gates[None], eye[None], [rollout.start.seed])
    picture = Image.fromarray(view)
    ahead = np.flatnonzero(rollout["endings"][step] == GateOutcome.AHEAD)
    if len(ahead):
        _number(picture, lens, eye, gates[ahead[0]], int(ahead[0]) + 1)
    _drone(picture, lens, eye, states[-1])
    return picture


def _eye(states: Floats) -> Floats:
    """Return the pose (7,) of a level camera behind the last of some states of the drone."""
    headings = np.unwrap([float(heading_of(*state[3:7])) for state in states])
    padded = np.concatenate([np.full(_LAG - len(states), headings[0]), headings])
    heading = float(padded.mean())
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    place = states[-1, :3] - _BEHIND_M * ahead + np.array([0.0, 0.0, _ABOVE_M])
    turned = Rotation.from_euler("ZY", [heading, np.deg2rad(TILT_DEG + _DOWN_DEG)])
    return np.concatenate([place, turned.as_quat()])


def _number(
    picture: Image.Image, lens: DroneCamera, eye: Floats, gate: Floats, number: int
) -> None:
    ((x, y),) = lens.project(eye, np.array([[gate[0], gate[1], TOP_M + 0.35]]))
    away = float(np.linalg.norm(gate[:2] - eye[:2]))
    size = float(np.clip(150 / max(away, 1.0), 13, 30))
    if 0 <= x < picture.width:  # NaN where the gate is behind the camera
        draw = ImageDraw.Draw(picture)
        y = max(y, size + 4)  # a near gate is higher than the picture
        draw.text(
            (x, y),
            str(number),
            fill=_WHITE,
            font=font(round(size), bold=True),
            anchor="mb",
            stroke_width=2,
            stroke_fill=INK_RGB,
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
    if min(width, height) < 1 or max(width, height) > 2 * picture.width:
        return
    finer = Image.new("RGBA", (_FINE * width, _FINE * height), (*INK_RGB, 0))
    draw = ImageDraw.Draw(finer)
    angles = np.linspace(0, 2 * np.pi, 25)[:-1]
    ring = _ROTOR_M * np.stack([np.cos(angles), np.sin(angles), np.zeros(24)], axis=1)
    body = np.array([[0.07, 0.035, 0], [0.07, -0.035, 0], [-0.07, -0.035, 0], [-0.07, 0.035, 0]])
    arms = np.array([[x, y, 0.0] for x in (ARM_X_M, -ARM_X_M) for y in (ARM_Y_M, -ARM_Y_M)])
    for x, y, _ in arms:
        draw.line(seen(np.array([[0, 0, 0], [x, y, 0.0]])), fill=(*INK_RGB, 255), width=3 * _FINE)
    for deck in (-0.02, 0.02):
        draw.polygon(
            seen(body + np.array([0, 0, deck])), fill=(*INK_RGB, 255), outline=(*_WHITE, 255)
        )
    for x, y, _ in arms:
        colour = rgb(YELLOW) if x > 0 else (220, 226, 232)
        rotor = seen(ring + np.array([x, y, 0.03]))
        draw.polygon(rotor, fill=(*colour, 150))
        draw.line([*rotor, rotor[0]], fill=(*INK_RGB, 255), width=_FINE)
    small = finer.resize((width, height), Image.Resampling.BOX)
    picture.paste(small, (int(corner[0]), int(corner[1])), small)
