"""Object detection under attack: camera, light and paint chosen so that the detector misses."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from sada_gym import agents
from sada_gym.agents.contract import identity_of
from sada_gym.application import Application, Scored, validate_world
from sada_gym.envs.detection.backdrop import random_backdrop
from sada_gym.envs.detection.behaviour import behaviour
from sada_gym.envs.detection.detector import Detections, DetectorAgent, DetectorLike, listed
from sada_gym.envs.detection.frame import SIDE, annotate, legend
from sada_gym.envs.detection.parameter_sets import (
    COLOUR,
    DEFAULT_PARAMETERS,
    DEFAULT_PITCH_DEG,
    PARAMETER_SETS,
    POLE_SHIFT,
    find_parameters,
)
from sada_gym.envs.detection.renderers.base import (
    DEFAULT_KEY,
    DEFAULT_RENDERER,
    Renderer,
    Rendering,
    default_renderer,
    find_renderer,
    validate_renderings,
)
from sada_gym.envs.detection.scene import PLACEMENT, Scene
from sada_gym.envs.detection.shapes import fingerprint
from sada_gym.envs.detection.shapes.model import Shape
from sada_gym.envs.detection.shapes.registry import DEFAULT_SHAPES, find_shapes, is_named
from sada_gym.errors import UserError, check_integer, check_known
from sada_gym.foundations.behaviour import Behaviour
from sada_gym.foundations.frames import Frame, LegendEntry
from sada_gym.foundations.seeds import validate_seeds
from sada_gym.parameters import Mu

MAX_IMAGE_SIZE = 4_096
"""Pixels a side of the largest picture: its samples take 2 GB."""


class DetectionApplication(Application):
    """A frozen detector is shown one object in an urban place.

    ## Description
    A shape of the class stands in the middle of an open place with ground, buildings and sky. The
    adversary places the camera and the main light, which look at the shape's centre, and paints the
    shape. The detector gets the picture; its highest confidence in the class is the score Q. The
    seed picks the shape and the place, so the same mu can give different Q. Everything is
    synthetic: our own procedures made shapes, places and light, and no photograph is involved.

    ## Action Space
    `Box(-1, 1, (8,), float32)`, mapped linearly to:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | camera distance from the object's centre | 8 | 14.5 | scene units |
    | 1 | camera azimuth; 0 looks at the front | -180 | 180 | deg |
    | 2 | camera pitch above the horizon | 0 | 51.6 | deg |
    | 3 | light azimuth relative to the camera; 180 is backlight | -180 | 180 | deg |
    | 4 | light pitch above the horizon | 3 | 90 | deg |
    | 5, 6, 7 | red, green, blue of the object's paint | 0 | 1 | sRGB |

    An object measures 5 scene units from corner to corner of its bounding box.

    ## Observation Space
    `Box(-1, 1, (10,), float32)`: last mu (0 to 7), last score (8), share of the steps left (9);
    zeros where there is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`: minus the detector's highest confidence in the class
    among its best 20 detections, 0 where there is none. `coco-centernet` always gives its highest
    confidence in the class.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.3), `seed`, `parameters`, `shape`, `box` (x0 y0 x1 y1 in pixels, the true
    one, zeros where the object is out of sight) and `detections` (best first, a list of `box`,
    `label`, `score`).

    ## Arguments
    - `object_class="car"`: aeroplane, bench, bicycle, boat, bottle, bus, car, chair, diningtable,
      motorbike, train or truck; each has an id of its own, such as `SADA-Detection-Car-v0`.
    - `agent=None`: a shipped detector (`photographer`, the default, or `surveyor`), a fetched one
      (`coco-centernet`, `efficientnet-lite0`), `torchvision:NAME`, a safetensors file, or any model
      with torchvision's calling convention, with `labels={"car": 3}`.
    - `agent_id=None`: names an in-memory model where scores are stored; by default a hash of its
      weights.
    - `shapes=None`: the name of a set of shapes; by default `benchmark`, our 100. Or a folder of
      CAD files of your own, one folder a class, with `skip_unreadable=False`.
    - `image_size="default"`: pixels a side, 128 by default; a multiple of 16 for the shipped
      detectors.
    - `renderer=None`: the name of a renderer, by default `rasteriser`; or a `Renderer` of your own,
      as an object or as `module:Class`.
    - `tile=None`: images in one call of the detector; by default 1 for a model of your own, and 4
      for the shipped architecture.
    - `parameters="paper"`: the eight above. `viewpoint` has four, camera azimuth and pitch, light
      azimuth and pitch; the camera's distance is then 11.25 and the paint blue. `occlusion` has
      three, camera azimuth and pitch, and the shift of a pole in the foreground, -1 to 1 from edge
      to edge of the picture; distance and paint are those of `viewpoint`, both angles of the light
      45. `unpainted` has the five without paint, which is grey (0.5, 0.5, 0.5) where a shape takes
      any.
    - `camera_pitch_deg=None`: another range of the camera's pitch than 0 to 51.6, such as (5, 30).
    - `only=None`: the name of the only shape to show, such as `car/saloon-0`, or a list of names.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    name: ClassVar[str] = "SADA-Detection"
    version: ClassVar[int] = 0
    fooling_threshold = 0.3
    sample_size = 250
    parameters = PARAMETER_SETS[DEFAULT_PARAMETERS].parameters
    default_agent: ClassVar[str] = "photographer"
    default_shapes: ClassVar[str] = DEFAULT_SHAPES
    default_image_size: ClassVar[int] = 128

    def __init__(
        self,
        object_class: str = "car",
        *,
        agent: str | Path | DetectorLike | None = None,
        labels: Mapping[str, int] | None = None,
        agent_id: str | None = None,
        shapes: str | Path | None = None,
        skip_unreadable: bool = False,
        image_size: int | Literal["default"] = "default",
        renderer: str | Renderer | None = None,
        tile: int | None = None,
        parameters: str = DEFAULT_PARAMETERS,
        camera_pitch_deg: Sequence[float] | None = None,
        only: str | Sequence[str] | None = None,
    ) -> None:
        if image_size == "default":
            image_size = self.default_image_size
        check_integer("image_size", image_size, 32, MAX_IMAGE_SIZE)
        self._parameters_name = parameters
        self._parameter_set = find_parameters(parameters, camera_pitch_deg)
        self.parameters = self._parameter_set.parameters
        self.object_class, self.image_size = object_class, image_size
        self._shapes_source = self.default_shapes if shapes is None else shapes
        self.shapes = find_shapes(
            self._shapes_source, object_class, skip_unreadable=skip_unreadable
        )
        self._only = None if only is None else [only] if isinstance(only, str) else list(only)
        if self._only is not None:
            self.shapes = _chosen(self.shapes, self._only)
        self.agent_name, self.agent = agents.resolve(
            self.default_agent if agent is None else agent, self.name, agent_id
        )
        self.label = _label(object_class, self.agent, labels)
        self._detector = DetectorAgent(self.agent, tile, image_size, label=self.label)
        self._agent_id = agent_id
        is_default = renderer in (None, DEFAULT_RENDERER, DEFAULT_KEY)
        self._renderer_name = renderer if isinstance(renderer, str) and not is_default else None
        # made last, so that nothing has to close it where another argument is refused
        self._renderer = None if is_default else find_renderer(renderer)

    @property
    def legend(self) -> tuple[LegendEntry, ...]:
        """What the boxes in frames are."""
        return legend(self.object_class)

    @property
    def tile(self) -> int:
        """Images in one call of the detector."""
        return self._detector.tile

    @property
    def renderer(self) -> Renderer:
        """What draws the scenes; the default one is shared by the process."""
        return default_renderer() if self._renderer is None else self._renderer

    @property
    def seconds_per_world(self) -> float | None:
        """The seconds of a picture, where the renderer is slow."""
        return self.renderer.seconds_per_picture(self.image_size)

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        settings = {
            "object_class": self.object_class,
            "label": self.label,
            "image_size": self.image_size,
            "renderer": DEFAULT_KEY if self._renderer is None else self._renderer.key,
            "tile": self.tile,
        }
        # parts chosen by a name are written by it: settings can be used as keywords again
        if self._renderer_name is not None:
            settings["renderer"] = self._renderer_name
        is_default = self._shapes_source == DEFAULT_SHAPES == self.default_shapes
        if not is_default and is_named(self._shapes_source):
            settings["shapes"] = self._shapes_source
        # left out where they are the defaults: what was stored before they came stays valid
        if self._parameters_name != DEFAULT_PARAMETERS:
            settings["parameters"] = self._parameters_name
        if (pitch := self._parameter_set.pitch_range) != DEFAULT_PITCH_DEG:
            settings["camera_pitch_deg"] = list(pitch)
        if self._only is not None:
            settings["only"] = self._only
        return settings

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the detector's identity and all that is not the benchmark's own.

        None where the detector or the renderer has no identity.
        """
        agent = identity_of(self._detector, self.agent, self._agent_id)
        if agent is None or (self._renderer is not None and self._renderer.identity is None):
            return None
        parts = [agent, "" if self._shapes_source == DEFAULT_SHAPES else fingerprint(self.shapes)]
        if self._renderer is not None and self._renderer_name is not None:
            parts.append(self._renderer.key)  # the settings hold its name only
        return hashlib.sha256("|".join(parts).encode()).hexdigest()

    def scene(self, mu: npt.NDArray[np.float32], seed: int) -> Scene:
        """Lay out the scene of one mu, (d,): the seed picks shape and place, mu sets the rest."""
        rng = np.random.default_rng(seed)
        shape = self.shapes[int(rng.integers(len(self.shapes)))]
        values = self._parameter_set.values(mu)
        placed: dict[str, Any] = {name: values[name] for name in PLACEMENT}
        red, green, blue = (values[name] for name in COLOUR)
        backdrop = random_backdrop(rng)
        pole = values.get(POLE_SHIFT)
        colour = red, green, blue
        return Scene(shape, colour, backdrop=backdrop, seed=seed, occluder=pole, **placed)

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scenes = self._scenes(mu, seeds)
        scores, extras = [], []
        for scene, (rendering, detections) in zip(scenes, self._detected(scenes), strict=True):
            scores.append(detections["scores"][detections["labels"] == self.label].max(initial=0.0))
            box = np.zeros(4) if rendering.box is None else rendering.box
            extra = {"shape": scene.shape_name, "box": box, "detections": listed(detections)}
            extras.append(extra)
        return Scored(np.array(scores, dtype=np.float64), extras)

    def _scenes(self, mu: Mu, seeds: Sequence[int]) -> list[Scene]:
        return [self.scene(row, seed) for row, seed in zip(mu, seeds, strict=True)]

    def _renderings(self, scenes: Sequence[Scene]) -> list[Rendering]:
        renderings = self.renderer.render_batch(scenes, self.image_size)
        return validate_renderings(renderings, self.renderer, len(scenes), self.image_size)

    def _detected(self, scenes: Sequence[Scene]) -> Iterator[tuple[Rendering, Detections]]:
        renderings = self._renderings(scenes)
        answers = self._detector.act([rendering.image for rendering in renderings])
        return zip(renderings, answers, strict=True)

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw what the detector sees, with the object's true box and the detections."""
        batch: Any = [mu]
        return next(self.render_batch(batch, [seed]))

    def render_batch(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Iterator[Frame]:
        """Draw such frames of several worlds, whose pictures the detector sees together."""
        return self._frames(mu, seeds, finer=False)

    def film_batch(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Iterator[Frame]:
        """Draw them in more detail than the detector sees, if the renderer has `any_size`."""
        return self._frames(mu, seeds, finer=self.renderer.any_size)

    def _frames(self, mu: npt.ArrayLike, seeds: Sequence[int], *, finer: bool) -> Iterator[Frame]:
        batch = self.parameters.validate(mu)
        scenes = self._scenes(batch, validate_seeds(seeds, len(batch)))
        large = self.renderer.render_batch(scenes, SIDE) if finer else [None] * len(scenes)
        for (rendering, detections), more in zip(self._detected(scenes), large, strict=True):
            image = None if more is None else more.image
            yield annotate(rendering, detections, self.class_names, self.label, image)

    @property
    def class_names(self) -> dict[int, str]:
        """The names of the detector's labels, as far as they are known."""
        labels = getattr(self.agent, "labels", None)
        known = labels if isinstance(labels, Mapping) else {}
        return {self.label: self.object_class, **{label: name for name, label in known.items()}}

    def behaviour(self, info: Mapping[str, Any]) -> Behaviour:
        """Say which class the detector saw in the place of the true one."""
        return behaviour(info, self.label, self.class_names, self.fooling_threshold)

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw what the detector sees."""
        row, seed = validate_world(self.parameters, mu, seed)
        return self._renderings(self._scenes(row, [seed]))[0].image

    def close(self) -> None:
        """Close the renderer, unless it was handed in or is the one that the process shares."""
        if self._renderer is not None and self._renderer_name is not None:
            self._renderer.close()


def _chosen(shapes: Sequence[Shape], only: Sequence[str]) -> tuple[Shape, ...]:
    """Return the shapes of some names, at least one, in the set's order."""
    check_known("shape", only, [shape.name for shape in shapes])
    if not only:
        raise UserError("Expected only to name at least one shape, got none. Leave it out.")
    return tuple(shape for shape in shapes if shape.name in only)


def _label(object_class: str, agent: Any, labels: Mapping[str, int] | None) -> int:
    known = labels if labels is not None else getattr(agent, "labels", None)
    if not isinstance(known, Mapping) or object_class not in known:
        given = "none" if not isinstance(known, Mapping) else ", ".join(map(str, known))
        raise UserError(
            f"Expected the detector's label of {object_class!r}, got labels for: {given}. "
            f"Pass labels={{{object_class!r}: number}} with the number that the model gives it."
        )
    label = known[object_class]
    check_integer(f"labels[{object_class!r}]", label, -(2**63), 2**63 - 1)
    return int(label)
