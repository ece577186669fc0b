"""What a renderer is given and what it gives back: the scene, the view, the ground truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.backdrop import Backdrop
from sada_gym.envs.detection.shapes.model import Shape

FIELD_OF_VIEW_DEG = 42.0

Vector = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scene:
    """One object in an urban place, seen and lit from somewhere.

    Azimuths run counter-clockwise seen from above. A camera azimuth of 0 looks at the object's
    front; the light's azimuth is relative to the camera's, so 0 lights from behind the camera and
    180 is backlight.

    Attributes:
        shape: The object; None leaves the place empty.
        colour: Its paint, sRGB in [0, 1].
        camera_distance: From the object's centre, in scene units.
        camera_azimuth_deg: See above.
        camera_pitch_deg: Above the horizon.
        light_azimuth_deg: See above.
        light_pitch_deg: Above the horizon.
        backdrop: The place around the object.
        aim: Where the camera looks, as an offset from the object's centre in units of half the
            image's height, (right, up); (0, 0) centres the object.
    """

    shape: Shape | None
    colour: tuple[float, float, float]
    camera_distance: float
    camera_azimuth_deg: float
    camera_pitch_deg: float
    light_azimuth_deg: float
    light_pitch_deg: float
    backdrop: Backdrop
    aim: tuple[float, float] = (0.0, 0.0)

    @property
    def shape_name(self) -> str:
        """The object's name, empty where there is none."""
        return "" if self.shape is None else self.shape.name


@dataclass(frozen=True, eq=False)
class Rendering:
    """A picture of a scene and what is known of the object in it.

    Attributes:
        image: (size, size, 3) uint8, RGB.
        mask: (size, size) bool, pixels mostly covered by the object.
        box: (4,) float64, x0 y0 x1 y1 in pixels; None where no object is in sight.
    """

    image: npt.NDArray[np.uint8]
    mask: npt.NDArray[np.bool_]
    box: npt.NDArray[np.float64] | None


class Renderer(Protocol):
    """Draws scenes. A renderer is pure: the same scene gives the same bytes, in any process."""

    def render(self, scene: Scene, image_size: int) -> Rendering:
        """Draw a scene as a square image of `image_size` pixels."""
        ...


@dataclass(frozen=True, eq=False)
class View:
    """A pinhole camera: where it stands, its axes, its frustum.

    Attributes:
        eye: (3,) position.
        axes: (3, 3), rows right, up, backward (unit vectors).
        tangent: Half the image's height at distance 1.
        offset: Principal point in units of half the image, (right, up).
    """

    eye: Vector
    axes: Vector
    tangent: float
    offset: tuple[float, float]

    @property
    def matrix(self) -> Vector:
        """The world-to-camera matrix, (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.axes
        matrix[:3, 3] = -self.axes @ self.eye
        return matrix


def direction(azimuth_deg: float, pitch_deg: float) -> Vector:
    """Unit vector from the object towards an azimuth and a pitch."""
    azimuth, pitch = math.radians(azimuth_deg), math.radians(pitch_deg)
    return np.array(
        [
            math.cos(pitch) * math.cos(azimuth),
            math.cos(pitch) * math.sin(azimuth),
            math.sin(pitch),
        ]
    )


def axes_facing(backward: Vector) -> Vector:
    """Rows right, up, backward of a viewer that looks along -backward with z upwards."""
    x, y, z = backward.tolist()
    norm = math.hypot(x, y)
    right, ahead = (-y / norm, x / norm) if norm > 1e-9 else (0.0, 1.0)
    up = (-z * ahead, z * right, x * ahead - y * right)
    return np.array([(right, ahead, 0.0), up, (x, y, z)])


def centre_of(scene: Scene) -> Vector:
    """The point that camera and light look at: the middle of the object's bounding box."""
    return np.array([0.0, 0.0, 0.5 * scene.shape.height if scene.shape is not None else 1.0])


def view_of(scene: Scene) -> View:
    """The camera of a scene."""
    backward = direction(scene.camera_azimuth_deg, scene.camera_pitch_deg)
    return View(
        eye=centre_of(scene) + scene.camera_distance * backward,
        axes=axes_facing(backward),
        tangent=math.tan(math.radians(FIELD_OF_VIEW_DEG) / 2),
        offset=scene.aim,
    )


def light_of(scene: Scene) -> Vector:
    """Unit vector from the object towards the light."""
    return direction(scene.camera_azimuth_deg + scene.light_azimuth_deg, scene.light_pitch_deg)
