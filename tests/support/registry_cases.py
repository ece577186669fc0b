"""What the tests of all ids need to know of an application, by its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from metadrive_agents import Swerver

from sada_gym.envs.driving.episodes import ACTION_SPACE, OBSERVATION_SPACE


class NaNPilot:
    """A pilot without a command: its drones are lost at once."""

    fingerprint = "nan-pilot"

    def start(self, count):
        pass

    def act(self, episodes, which):
        return np.full((len(which), 4), np.nan)


class FullLockDriver:
    """A driver that steers to the right with full throttle, and leaves its lane at once."""

    observation_space, action_space = OBSERVATION_SPACE, ACTION_SPACE

    def predict(self, observation, *, deterministic):
        return np.ones((len(observation["speed"]), 2), np.float32), None


@dataclass(frozen=True)
class PurityCase:
    """Worlds and batch sizes with which the registry's tests check that scores are pure.

    Attributes:
        n: Number of worlds; each is also tried alone.
        sizes: Sizes of batches beside 1 and n; each begins at another world, so that a world
            stands at several places of a tile.
    """

    n: int
    sizes: tuple[int, ...] = ()


@dataclass(frozen=True)
class RegistryCase:
    """What the tests of all ids need to know of an application.

    Attributes:
        slow: Whether an evaluation is a whole episode in closed loop, or many.
        quick_kwargs: Keywords that make an evaluation quick where any agent will do.
        quick_agent: Makes an agent whose episodes are short, where one is needed.
        shipped_on: The suffix of the track on which the shipped agent is tested; None takes the one
            that the general id is by default, or the general id itself.
        purity: The least that would still catch a score that depends on its tile, its place or the
            size of the batch, tried on one track.
        purity_elsewhere: The same for the other tracks, which run the same code.
        brief: Seeds of worlds in which the shipped agent's episodes end early, by suffix. They were
            found by trying; any other seed tests the same and takes longer.
        telling: Seeds with which a dead parameter would be noticed in the first worlds, by suffix;
            found likewise.
    """

    slow: bool = False
    quick_kwargs: Mapping[str, Any] = field(default_factory=dict)
    quick_agent: Callable[[], Any] | None = None
    shipped_on: str | None = None
    purity: PurityCase = PurityCase(3, (2,))
    purity_elsewhere: PurityCase = PurityCase(3, (2,))
    brief: Mapping[str, int] = field(default_factory=dict)
    telling: Mapping[str, int] = field(default_factory=dict)


_TILES_OF_16 = PurityCase(40, (2, 15, 16, 17, 31, 33))

_CASES = {
    "SADA-Analytic": RegistryCase(purity=PurityCase(70, tuple(range(1, 71)))),
    "SADA-Detection": RegistryCase(
        quick_kwargs={"tile": 1},  # one image a call instead of a tile of them
        shipped_on="Car",
        # tiles of 4 images: 6 worlds are a full tile and a padded one, 3 to 5 are at its border
        purity=PurityCase(6, (2, 3, 4, 5)),
    ),
    "SADA-DetectionCoco": RegistryCase(shipped_on="Car"),
    "SADA-Digits": RegistryCase(purity=_TILES_OF_16),
    "SADA-Driving": RegistryCase(
        slow=True,
        quick_agent=FullLockDriver,
        shipped_on="Straight",
        # tiles of 16 cars, and one evaluation is five: 1, 2 and 3 fill tiles in as many ways
        purity_elsewhere=PurityCase(2),
        brief={"Straight": 5, "OneCurve": 5, "Navigation": 5},
        telling={"Straight": 1, "OneCurve": 1},
    ),
    # a world costs a second and more: tests/envs/metadrive tries purity in more of them
    "SADA-DrivingMetaDrive": RegistryCase(slow=True, quick_agent=Swerver, purity=PurityCase(2)),
    "SADA-Pixel": RegistryCase(purity=_TILES_OF_16),
    "SADA-Robot": RegistryCase(slow=True, purity=PurityCase(4, (3,))),
    "SADA-UAV": RegistryCase(
        slow=True,
        quick_agent=NaNPilot,
        shipped_on="4Anchors",
        # tiles of 8 drones; test_racing_pilot.py flies more than one tile
        purity_elsewhere=PurityCase(2),
        brief={"3Anchors": 8, "4Anchors": 1, "5Anchors": 15},
        telling={"4Anchors": 2, "5Anchors": 3},
    ),
}


def case_of(application: str) -> RegistryCase:
    """Return the case of an application by its name; the usual one where it needs no other."""
    return _CASES.get(application, RegistryCase())
