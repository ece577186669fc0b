"""Object detection under attack: camera, light and paint chosen so that the detector misses."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from sada_gym import agents
from sada_gym.agents.contract import known_as
from sada_gym.application import Application, Frame, Scored, validate_world
from sada_gym.envs.detection.backdrop import random_backdrop
from sada_gym.envs.detection.detector import (
    DETECTOR_TILE,
    DetectorAgent,
    DetectorLike,
    listed,
)
from sada_gym.envs.detection.picture import annotate
from sada_gym.envs.detection.renderers import Renderer, Rendering, default_renderer
from sada_gym.envs.detection.renderers.base import (
    DEFAULT,
    checked_renderer,
    checked_renderings,
)
from sada_gym.envs.detection.scene import Scene
from sada_gym.envs.detection.shapes import (
    CLASSES,
    Shape,
    benchmark_shapes,
    fingerprint,
    load_class,
)
from sada_gym.errors import UserError, UserTypeError
from sada_gym.parameters import Mu, Parameter, ParameterSpace


class DetectionApplication(Application):
    """A frozen detector looks at one object of a class; Q is its confidence in that class.

    Args:
        object_class: One of the 12 classes, or of the folders in `shapes`.
        agent: A shipped detector's name, a safetensors file with the shipped architecture's
            weights, or any model with torchvision's calling convention.
        labels: The model's label of each class, such as {"car": 3}; the shipped detectors and
            models with a `labels` attribute know their own.
        agent_id: Names an in-memory model in evaluation stores; by default a hash of its weights.
        shapes: A folder with a user's own CAD files instead of the benchmark's shapes; see
            `sada_gym.envs.detection.shapes.cad`.
        skip_unreadable: Go on without CAD files that cannot be read.
        image_size: Pixels a side, a multiple of 16 for the shipped detectors.
        renderer: Renders the scenes; by default the process's TinyRenderer.
        tile: Images in one call of the detector; the last call is filled up with black images. A
            network's float32 output depends on the batch's size, so the size never varies. By
            default 1 for a user's model, and 14 for the shipped architecture.

    Raises:
        ValueError: If the class is unknown, the model's label for it is not given, the model is in
            training mode or has weights that are not finite, or the size or the tile is out of
            range.
    """

    name: ClassVar[str] = "SADA-Detection"
    version: ClassVar[int] = 0
    fooling_threshold = 0.3
    sample_size = 250
    parameters = ParameterSpace(
        Parameter("camera_distance", 8.0, 14.5, "scene units"),
        Parameter("camera_azimuth_deg", -180.0, 180.0, "deg"),
        Parameter("camera_pitch_deg", 0.0, 51.6, "deg"),
        Parameter("light_azimuth_deg", -180.0, 180.0, "deg"),
        Parameter("light_pitch_deg", 3.0, 90.0, "deg"),
        Parameter("colour_red", 0.0, 1.0),
        Parameter("colour_green", 0.0, 1.0),
        Parameter("colour_blue", 0.0, 1.0),
    )

    def __init__(
        self,
        object_class: str = "car",
        *,
        agent: str | Path | DetectorLike = "photographer",
        labels: Mapping[str, int] | None = None,
        agent_id: str | None = None,
        shapes: str | Path | None = None,
        skip_unreadable: bool = False,
        image_size: int = 128,
        renderer: Renderer | None = None,
        tile: int | None = None,
    ) -> None:
        if image_size < 32:
            raise UserError(f"Expected an image_size of at least 32 pixels, got {image_size}.")
        self.object_class, self.image_size = object_class, image_size
        self.shapes = _shapes(object_class, shapes, skip_unreadable)
        self._own_shapes = shapes is not None
        self._renderer = None if renderer is None else checked_renderer(renderer)
        self.agent_name, self.agent = agents.resolve(agent, self.name, agent_id)
        self._detector = DetectorAgent(self.agent, tile)
        self.label = _label(object_class, self.agent, labels)
        self._agent_id = agent_id

    @property
    def tile(self) -> int:
        """Images in one call of the detector."""
        return self._detector.tile

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on; `tile` only where it is not 14."""
        settings = {
            "object_class": self.object_class,
            "label": self.label,
            "image_size": self.image_size,
            "renderer": DEFAULT if self._renderer is None else self._renderer.stored_name,
        }
        # published results and older stores hold no tile: theirs is 14
        return settings if self.tile == DETECTOR_TILE else {**settings, "tile": self.tile}

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the detector's identity and, where a user brought them, the shapes.

        None where the detector or a user's renderer has no identity.
        """
        agent = known_as(self._detector, self.agent, self._agent_id)
        if agent is None or (self._renderer is not None and self._renderer.identity is None):
            return None
        parts = [agent, fingerprint(self.shapes) if self._own_shapes else ""]
        return hashlib.sha256("|".join(parts).encode()).hexdigest()

    def scene(self, mu: npt.NDArray[np.float32], seed: int) -> Scene:
        """The scene of one mu, (8,): the seed picks shape and place, mu the rest."""
        rng = np.random.default_rng(seed)
        shape = self.shapes[int(rng.integers(len(self.shapes)))]
        distance, azimuth, pitch, light_azimuth, light_pitch, *colour = self.parameters.physical(
            mu
        ).tolist()
        return Scene(
            shape=shape,
            colour=(colour[0], colour[1], colour[2]),
            camera_distance=distance,
            camera_azimuth_deg=azimuth,
            camera_pitch_deg=pitch,
            light_azimuth_deg=light_azimuth,
            light_pitch_deg=light_pitch,
            backdrop=random_backdrop(rng),
            seed=seed,
        )

    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scenes = [self.scene(row, seed) for row, seed in zip(mu, seeds, strict=True)]
        renderings = self._renderings(scenes)
        found = self._detector.act([rendering.image for rendering in renderings])
        extras = [
            {
                "shape": scene.shape_name,
                "box": np.zeros(4) if rendering.box is None else rendering.box,
                "detections": listed(detections),
            }
            for scene, rendering, detections in zip(scenes, renderings, found, strict=True)
        ]
        scores = [
            detections["scores"][detections["labels"] == self.label].max(initial=0.0)
            for detections in found
        ]
        return Scored(np.array(scores, dtype=np.float64), extras)

    def _renderings(self, scenes: Sequence[Scene]) -> list[Rendering]:
        renderer = default_renderer() if self._renderer is None else self._renderer
        renderings = renderer.render_batch(scenes, self.image_size)
        return checked_renderings(renderings, renderer, len(scenes), self.image_size)

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """The frame that the detector sees, with the object's true box and the detections."""
        rendering = self._rendering(mu, seed)
        names = {self.label: self.object_class}
        known = getattr(self.agent, "labels", None)
        if isinstance(known, Mapping):
            names = {label: name for name, label in known.items()}
        detections = self._detector.act([rendering.image])[0]
        return annotate(rendering, detections, names, self.label)

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """The frame that the detector sees."""
        return self._rendering(mu, seed).image

    def _rendering(self, mu: npt.ArrayLike, seed: int) -> Rendering:
        row, seed = validate_world(self.parameters, mu, seed)
        return self._renderings([self.scene(row[0], seed)])[0]


def _shapes(
    object_class: str, folder: str | Path | None, skip_unreadable: bool
) -> tuple[Shape, ...]:
    if folder is None:
        if object_class not in CLASSES:
            raise UserError(
                f"Expected object_class to be one of {', '.join(CLASSES)}, got {object_class!r}. "
                "Give shapes=PATH to bring CAD files of another class."
            )
        return benchmark_shapes(object_class)
    if not isinstance(folder, str | Path):
        raise UserTypeError(f"Expected shapes to be the path of a folder or None, got {folder!r}.")
    return load_class(folder, object_class, skip_unreadable=skip_unreadable)


def _label(object_class: str, agent: Any, labels: Mapping[str, int] | None) -> int:
    known = labels if labels is not None else getattr(agent, "labels", None)
    if not isinstance(known, Mapping) or object_class not in known:
        given = "none" if not isinstance(known, Mapping) else ", ".join(map(str, known))
        raise UserError(
            f"Expected the detector's label of {object_class!r}, got labels for: {given}. "
            f"Pass labels={{{object_class!r}: number}} with the number that the model gives it."
        )
    return int(known[object_class])
