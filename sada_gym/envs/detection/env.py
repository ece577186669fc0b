"""SADA-Detection as Gymnasium environments: a detector attacked through camera, light and paint."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from sada_gym.envs.adversary import AdversaryEnv, AdversaryVectorEnv
from sada_gym.envs.detection.application import DetectionApplication
from sada_gym.envs.detection.detector import DetectorLike


class DetectionEnv(AdversaryEnv):
    """A frozen detector is shown one object in an urban place.

    ## Description
    A random CAD shape of the class stands in the middle of an open place: ground, buildings, sky.
    Camera and main light look at its centre. The adversary places both and paints the object; the
    picture goes to the detector, and its highest confidence in the class is the score Q. The shape
    and the place vary with the evaluation's seed, so that Q is stochastic in mu alone. Everything
    is synthetic: shapes, place and light are our own procedures, no photograph is involved.

    ## Action Space
    `Box(-1, 1, (8,), float32)`, linear in:

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
    among its best 20 detections, 0 where there is none.

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
    - `agent="photographer"`: a shipped detector (`photographer`, `surveyor`), a safetensors file,
      or any model with torchvision's calling convention, with `labels={"car": 3}`.
    - `agent_id=None`: names an in-memory model in evaluation stores; by default a hash of its
      weights.
    - `shapes=None`: a folder of a user's CAD files, one folder a class, instead of the 100 shapes;
      `skip_unreadable=False`.
    - `image_size=128`: pixels a side.
    - `tile=None`: images in one call of the detector; by default 1 for a model of your own, and 14
      for the shipped architecture.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

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
        tile: int | None = None,
        horizon: int = 1,
        render_mode: str | None = None,
    ) -> None:
        application = DetectionApplication(
            object_class,
            agent=agent,
            labels=labels,
            agent_id=agent_id,
            shapes=shapes,
            skip_unreadable=skip_unreadable,
            image_size=image_size,
            tile=tile,
        )
        super().__init__(application, horizon=horizon, render_mode=render_mode)


class DetectionVectorEnv(AdversaryVectorEnv):
    """`DetectionEnv` in a batch: each shape is loaded once, the detector sees tiles of images."""

    def __init__(
        self,
        object_class: str = "car",
        *,
        num_envs: int = 1,
        agent: str | Path | DetectorLike = "photographer",
        labels: Mapping[str, int] | None = None,
        agent_id: str | None = None,
        shapes: str | Path | None = None,
        skip_unreadable: bool = False,
        image_size: int = 128,
        tile: int | None = None,
        horizon: int = 1,
        render_mode: str | None = None,
    ) -> None:
        application = DetectionApplication(
            object_class,
            agent=agent,
            labels=labels,
            agent_id=agent_id,
            shapes=shapes,
            skip_unreadable=skip_unreadable,
            image_size=image_size,
            tile=tile,
        )
        super().__init__(application, num_envs=num_envs, horizon=horizon, render_mode=render_mode)
