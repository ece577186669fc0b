"""Object detection under attack, with a detector of photographs and textured models."""

from __future__ import annotations

from typing import ClassVar

from sada_gym import agents
from sada_gym.envs.detection.application import DetectionApplication
from sada_gym.envs.detection.shapes.textured import check_installed
from sada_gym.errors import UserError


class CocoDetectionApplication(DetectionApplication):
    """A detector that was trained on photographs is shown one textured model in an urban place.

    ## Description
    The world is that of SADA-Detection, but others made the detector and the objects:
    CenterNet, trained on the photographs of COCO, looks at textured models of Sweet Home 3D and
    FlightGear. The adversary places the camera and the main light, and paints the model where it
    can be painted. The detector's highest confidence in the class is the score Q. The seed picks
    the model and the place.

    ## Action Space
    `Box(-1, 1, (8,), float32)`, or 5 without paint, mapped linearly to:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | camera distance from the object's centre | 8 | 14.5 | scene units |
    | 1 | camera azimuth; 0 looks at the front | -180 | 180 | deg |
    | 2 | camera pitch above the horizon; tracks may narrow it | 0 | 51.6 | deg |
    | 3 | light azimuth relative to the camera; 180 is backlight | -180 | 180 | deg |
    | 4 | light pitch above the horizon | 3 | 90 | deg |
    | 5, 6, 7 | red, green, blue of the object's paint | 0 | 1 | sRGB |

    ## Observation Space
    `Box(-1, 1, (d + 2,), float32)`: last mu, last score, share of the steps left; zeros where there
    is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` is that of
    SADA-Detection; the agent is fooled where score <= 0.3, as in the SADA paper.

    ## Arguments
    Those of SADA-Detection, with these defaults: `agent` is `coco-centernet`, `shapes` is
    `textured` and `image_size` is 320. Detector and models have to be installed once; without them
    the id names the commands.

    ## Version History
    - v0: initial version.
    """

    name: ClassVar[str] = "SADA-DetectionCoco"
    default_agent: ClassVar[str] = "coco-centernet"
    default_shapes: ClassVar[str] = "textured"
    default_image_size: ClassVar[int] = 320


def missing() -> str:
    """Say what has to be installed before the ids work; empty where all is there."""
    sentences = []
    for check in (_check_agent, check_installed):
        try:
            check()
        except UserError as error:
            sentences.append(str(error))
    return " ".join(sentences)


def _check_agent() -> None:
    agents.check_agent(CocoDetectionApplication.default_agent, CocoDetectionApplication.name)
