"""A detector that others trained, on photographs of a street."""

from __future__ import annotations

from typing import Any, ClassVar

from sada_gym import agents
from sada_gym.envs.images.application import ImageApplication
from sada_gym.envs.images.conditions import check_opencv, find_conditions
from sada_gym.envs.photos.street import film, street
from sada_gym.errors import UserError, check_known
from sada_gym.parameters import ParameterSpace


class PhotosApplication(ImageApplication):
    """A detector that was trained on photographs looks at a street with people.

    ## Description
    The adversary sets what a camera and the weather do to two of 40 photographs of a street, which
    the seed draws; it turns and enlarges them, too. People that the detector finds in the untouched
    photograph with a confidence of at least 0.4 should be found again, with at least 0.25 and an
    overlap of at least 0.5. The score Q is the share of those that are. Nobody labelled the
    photographs: a failure is a changed answer of the detector. The seed also draws the noise.

    ## Action Space
    `Box(-1, 1, (7,), float32)`, mapped to:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | rotation, clockwise | -20 | 20 | deg |
    | 1 | zoom, logarithmic | 0.4 | 2 | |
    | 2 | radius of the blur circle over the longer side | 0 | 0.01 | |
    | 3 | visibility in fog of a scene 30 m away, logarithmic | 30 | 10,000 | m |
    | 4 | exposure | -3 | 3 | EV |
    | 5 | noise of a small sensor at this ISO, logarithmic | 100 | 25,600 | |
    | 6 | JPEG's quality | 5 | 95 | |

    ## Observation Space
    `Box(-1, 1, (9,), float32)`: last mu (0 to 6), last score (7), share of the steps left (8);
    zeros where there is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`: minus the share of people that are found again.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.5), `seed`, `parameters`, `images` (the photographs' numbers), `right` and
    `of` (people found, people there), `extra` (other detections of people), `wrong` (what was
    missed in each photograph), and `invalid`: why, where nobody is left in the photographs.

    ## Arguments
    - `photos="street"`: the photographs; there is one set.
    - `agent="coco-centernet"`: the fetched detector, or what `sada_gym.ImageApplication` takes.
    - `agent_id=None`: names an in-memory model where scores are stored; by default a hash of its
      weights.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    name: ClassVar[str] = "SADA-Photos"
    parameters = ParameterSpace(*(each for c in find_conditions("common") for each in c.parameters))
    fooling_threshold = 0.5
    sample_size = 100

    def __init__(
        self, photos: str = "street", *, agent: Any = "coco-centernet", agent_id: str | None = None
    ) -> None:
        check_known("photos", [photos], ["street"])
        self.photos = photos
        check_opencv()
        super().__init__(
            street(),
            agent=agent,
            labels=False,
            task="detect",
            only=["person"],
            batch=2,
            name=type(self).name,
            agent_id=agent_id,
        )

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {"photos": self.photos, **super().settings}


def missing() -> str:
    """Say what has to be installed before the ids work; empty where all is there."""
    sentences = []
    for check in (check_opencv, film, _check_agent):
        try:
            check()
        except UserError as error:
            sentences.append(str(error))
    return " ".join(sentences)


def _check_agent() -> None:
    agents.check_agent("coco-centernet", PhotosApplication.name)
