"""Object detection under attack: camera, light and paint chosen so that the detector misses."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from sada_gym import agents
from sada_gym.application import Application, Frame, Scored, validate_world
from sada_gym.determinism import one_thread
from sada_gym.envs.detection.backdrop import random_backdrop
from sada_gym.envs.detection.picture import annotate
from sada_gym.envs.detection.scene import Renderer, Rendering, Scene
from sada_gym.envs.detection.shapes import (
    CLASSES,
    Shape,
    benchmark_shapes,
    fingerprint,
    load_class,
)
from sada_gym.errors import UserError
from sada_gym.parameters import Mu, Parameter, ParameterSpace

if TYPE_CHECKING:
    from torch import Tensor

TILE = 14
"""Images in one call of the detector. A network's float32 output depends on the batch's size, and
on the number of threads, so neither varies: the last tile is padded with black images. Larger
tiles make a batch cheaper and a single evaluation dearer."""

TOP_DETECTIONS = 20
"""Detections an image that are looked at, best first."""

DetectorLike = Callable[[list["Tensor"]], Sequence[Mapping[str, "Tensor"]]]
"""Anything with torchvision's calling convention: see `Detector` in `agent/network.py`."""


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
        renderer: Draws the scenes; by default the process's TinyRenderer.

    Raises:
        ValueError: If the class is unknown, the model's label for it is not given or the size is
            below 32.
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
    ) -> None:
        if image_size < 32:
            raise UserError(f"Expected an image_size of at least 32 pixels, got {image_size}.")
        self.object_class, self.image_size = object_class, image_size
        self.shapes = _shapes(object_class, shapes, skip_unreadable)
        self._own_shapes = shapes is not None
        self._renderer = renderer
        self.agent_name, found = agents.resolve(agent, self.name, agent_id)
        self.agent = _frozen(found)
        self.label = _label(object_class, self.agent, labels)
        self._agent_id = agent_id

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {
            "object_class": self.object_class,
            "label": self.label,
            "image_size": self.image_size,
            "renderer": "TinyRenderer" if self._renderer is None else type(self._renderer).__name__,
        }

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the detector's identity and, where a user brought them, the shapes."""
        weights = agents.fingerprint(self.agent)
        agent = agents.identity(weights, self.agent, self._agent_id)
        if agent is None:
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
        )

    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scenes = [self.scene(row, seed) for row, seed in zip(mu, seeds, strict=True)]
        renderings: dict[int, Rendering] = {}
        for i in sorted(range(len(scenes)), key=lambda i: scenes[i].shape_name):
            renderings[i] = self._render(scenes[i])  # sorted, so that a shape is loaded once
        found = self._detect([renderings[i].image for i in range(len(mu))])
        extras = [
            {
                "shape": scenes[i].shape_name,
                "box": np.zeros(4) if renderings[i].box is None else renderings[i].box,
                "detections": _listed(detections),
            }
            for i, detections in enumerate(found)
        ]
        scores = [
            detections["scores"][detections["labels"] == self.label].max(initial=0.0)
            for detections in found
        ]
        return Scored(np.array(scores, dtype=np.float64), extras)

    def _render(self, scene: Scene) -> Rendering:
        if self._renderer is not None:
            return self._renderer.render(scene, self.image_size)
        from sada_gym.envs.detection.renderers.tinyrenderer import shared_renderer

        return shared_renderer().render(scene, self.image_size)

    def _detect(self, images: Sequence[Frame]) -> list[dict[str, npt.NDArray[Any]]]:
        """Run the detector in tiles; each image's best detections as arrays, best first."""
        import torch

        black = torch.zeros(3, self.image_size, self.image_size)
        found: list[dict[str, npt.NDArray[Any]]] = []
        for start in range(0, len(images), TILE):
            tile = [
                torch.from_numpy(image).permute(2, 0, 1).float().div(255).contiguous()
                for image in images[start : start + TILE]
            ]
            padded = tile + [black] * (TILE - len(tile))
            with torch.inference_mode(), one_thread():
                detections = self.agent(padded)
            found += _checked(detections, len(padded))[: len(tile)]
        return found

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """The frame that the detector sees, with the object's true box and the detections."""
        rendering = self._rendering(mu, seed)
        names = {self.label: self.object_class}
        known = getattr(self.agent, "labels", None)
        if isinstance(known, Mapping):
            names = {label: name for name, label in known.items()}
        detections = self._detect([rendering.image])[0]
        return annotate(rendering, detections, names, self.label)

    def view(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """The frame that the detector sees."""
        return self._rendering(mu, seed).image

    def _rendering(self, mu: npt.ArrayLike, seed: int) -> Rendering:
        row, seed = validate_world(self.parameters, mu, seed)
        return self._render(self.scene(row[0], seed))


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
    return load_class(folder, object_class, skip_unreadable=skip_unreadable)


def _frozen(agent: DetectorLike) -> DetectorLike:
    if getattr(agent, "training", False):
        raise UserError(
            f"Expected a detector in evaluation mode, got {type(agent).__name__} in training mode, "
            "in which looking at images changes it. Call model.eval() first."
        )
    return agent


def _label(object_class: str, agent: Any, labels: Mapping[str, int] | None) -> int:
    known = labels if labels is not None else getattr(agent, "labels", None)
    if not isinstance(known, Mapping) or object_class not in known:
        given = "none" if not isinstance(known, Mapping) else ", ".join(map(str, known))
        raise UserError(
            f"Expected the detector's label of {object_class!r}, got labels for: {given}. "
            f"Pass labels={{{object_class!r}: number}} with the number that the model gives it."
        )
    return int(known[object_class])


def _listed(detections: Mapping[str, npt.NDArray[Any]]) -> list[dict[str, Any]]:
    """One dictionary a detection, best first: `box`, `label`, `score`."""
    columns = (detections[key].tolist() for key in ("boxes", "labels", "scores"))
    return [
        {"box": box, "label": label, "score": score}
        for box, label, score in zip(*columns, strict=True)
    ]


def _checked(detections: Any, count: int) -> list[dict[str, npt.NDArray[Any]]]:
    """The detections of a tile as arrays, best first; what breaks the convention is named."""
    convention = (
        "The detector must return, as torchvision's do, one dictionary an image with "
        "boxes (N, 4), labels (N,) and scores (N,) in [0, 1]."
    )
    if not isinstance(detections, Sequence) or len(detections) != count:
        what = f"{len(detections)} items" if hasattr(detections, "__len__") else type(detections)
        raise UserError(
            f"Expected {count} dictionaries from the detector, got {what}. {convention}"
        )
    checked = []
    for item in detections:
        missing = {"boxes", "labels", "scores"} - set(item)
        if missing:
            raise UserError(
                f"Expected {', '.join(sorted(missing))} from the detector. {convention}"
            )
        boxes, labels, scores = (
            item[key].detach().cpu().numpy() for key in ("boxes", "labels", "scores")
        )
        if boxes.shape != (len(scores), 4) or labels.shape != scores.shape or scores.ndim != 1:
            raise UserError(
                f"Expected boxes (N, 4), labels (N,), scores (N,) from the detector, got "
                f"{boxes.shape}, {labels.shape}, {scores.shape}. {convention}"
            )
        if not ((scores >= 0) & (scores <= 1)).all():
            raise UserError(
                f"Expected scores in [0, 1] from the detector, got {scores}. {convention}"
            )
        best = np.argsort(-scores, kind="stable")[:TOP_DETECTIONS]
        checked.append({"boxes": boxes[best], "labels": labels[best], "scores": scores[best]})
    return checked
