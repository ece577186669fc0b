"""Self-driving under attack: a camera's mount and the weather; Q is the share of arrivals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.application import Frame, Scored, validate_world
from sada_gym.envs.driving.agent.driver import Driver, DriverLike, as_driver
from sada_gym.envs.driving.camera.pinhole import Mount, camera
from sada_gym.envs.driving.episodes import Drives, Ending, Start
from sada_gym.envs.driving.world.benchmark_routes import LAYOUT, benchmark_routes
from sada_gym.envs.driving.world.weather import NAMES, WEATHERS
from sada_gym.envs.episodes.acting import Rollout
from sada_gym.envs.episodes.application import EpisodesApplication
from sada_gym.parameters import Mu, Parameter, ParameterSpace


class DrivingApplication(EpisodesApplication[Drives]):
    """A frozen driver on five routes of the benchmark's town.

    Args:
        task: `straight`, `one_curve` or `navigation`.
        agent: A shipped driver's name, a file of weights, an SB3 model, or a `Driver` as it is.
        agent_id: Names an in-memory model in evaluation stores; by default a hash of its weights.

    Raises:
        UserError: If task or agent is unknown, the agent's spaces are not the task's, or its
            weights are not finite numbers.
    """

    name = "SADA-Driving"
    fooling_threshold = 0.6
    sample_size = 100
    parameters = ParameterSpace(
        Parameter("camera_height_m", 1.0, 2.0, "m"),
        Parameter("camera_pitch_deg", -20.0, -10.0, "deg"),
        Parameter("weather", 0.0, float(len(NAMES)), choices=NAMES),
    )

    def __init__(
        self,
        task: str = "navigation",
        *,
        agent: str | Path | DriverLike = "cil",
        agent_id: str | None = None,
    ) -> None:
        self.task, self.routes = task, benchmark_routes(task)
        super().__init__(agent, agent_id)

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {"task": self.task}

    def _as_agent(self, given: Any) -> Driver:
        return as_driver(given)

    def camera_and_weather(self, mu: npt.NDArray[np.float32]) -> tuple[Mount, int]:
        """Give the camera's mount, and the weather's index, of one mu, (3,)."""
        height, pitch, place = self.parameters.physical(mu).tolist()
        return Mount(height, pitch), min(int(place), len(NAMES) - 1)

    def episodes(self, mu: Mu, seeds: Sequence[int]) -> Drives:
        """Begin all routes in the worlds of mu, five drives each: (5 n) of them."""
        starts = []
        for row, seed in zip(mu, seeds, strict=True):
            mount, weather = self.camera_and_weather(row)
            starts += [Start(route, mount, weather, seed) for route in self.routes]
        return Drives(camera(LAYOUT), starts)

    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        # the seed fixes the rain alone: a dry world is the same for all, and is driven once
        worlds = [
            (mount, weather, seed if WEATHERS[weather].rain else None)
            for (mount, weather), seed in zip(map(self.camera_and_weather, mu), seeds, strict=True)
        ]
        first = {world: i for i, world in reversed([*enumerate(worlds)])}
        rows = sorted(first.values())
        drives = self.episodes(mu[rows], [seeds[row] for row in rows])
        self.play(drives)
        routes = len(self.routes)
        of = [rows.index(first[world]) for world in worlds]
        ending = drives.ending.reshape(-1, routes)[of]
        progress = drives.progress_m.reshape(-1, routes)[of]
        lengths = [route.length_m for route in self.routes]
        extras = [
            {
                "weather": NAMES[weather],
                "endings": [Ending(code).name.lower() for code in codes],
                "progress": np.clip(made / lengths, 0.0, 1.0),
            }
            for (_, weather, _), codes, made in zip(worlds, ending, progress, strict=True)
        ]
        return Scored(drives.score.reshape(-1, routes).mean(axis=1)[of], extras)

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the camera's image where the driver first fails, above a map of all five drives."""
        from sada_gym.envs.driving.pictures import summary

        return summary(self.rollouts(mu, seed))

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the camera's image at the start of the first route."""
        from sada_gym.envs.driving.pictures import observation

        row, seed = validate_world(self.parameters, mu, seed)
        drives = self.episodes(row, [seed])
        return observation(drives.starts[0], drives.states[0])

    def _frames(self, rollouts: list[Rollout[Start]]) -> list[Frame]:
        from sada_gym.envs.driving.pictures import frames

        return frames(rollouts)
