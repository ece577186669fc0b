"""Self-driving under attack: a camera's mount and the weather; Q is the share of arrivals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sada_gym.application import Scored
from sada_gym.envs.driving.camera.pinhole import Mount, camera
from sada_gym.envs.driving.episodes import POLICY_HZ, DrivingEnd, DrivingEpisodes, DrivingStart
from sada_gym.envs.driving.world.route import LAYOUT, benchmark_routes
from sada_gym.envs.driving.world.weather import LIGHTS, NAMES
from sada_gym.envs.episodes.closed_loop import AgentLike, SimulatorApplication
from sada_gym.errors import UserTypeError
from sada_gym.foundations.arrays import Floats32
from sada_gym.parameters import Mu, Parameter, ParameterSpace


class DrivingApplication(SimulatorApplication[DrivingEpisodes]):
    """A frozen driver with a camera drives five routes through a town.

    ## Description
    The driver gets the image of a camera at the front of its car, its speed, and at junctions a
    command that says where to go. The adversary mounts the camera and chooses the weather; the
    score Q is the share of the five routes on which the car arrives in time without leaving its
    lane. The car is highway-env's. Town, light and weather are our own procedures: it is not CARLA. The
    seed fixes the rain, so that Q is random in the two rainy weathers only.

    ## Action Space
    `Box(-1, 1, (3,), float32)`, mapped linearly to:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | camera height | 1 | 2 | m |
    | 1 | camera pitch | -20 | -10 | deg |
    | 2 | weather, by sixths: ClearNoon, WetNoon, HardRainNoon, ClearSunset, WetCloudyNoon, SoftRainSunset | 0 | 6 | |

    All drivers were trained in the first four weathers: `cil` and `ppo` at 1.4 m and -15°,
    `cil-augmented` within 25 cm and 2.5° of that.

    ## Observation Space
    `Box(-1, 1, (5,), float32)`: last mu (0 to 2), last score (3), share of the steps left (4);
    zeros where there is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`: minus the share of arrivals.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.6), `seed`, `parameters`, `weather` (its name), `endings` (for each route
    `arrived`, `left_lane` or `too_late`) and `progress` (the share of each route that was driven).

    ## Arguments
    - `task="navigation"`: `straight`, `one_curve` or `navigation`; each has an id of its own, such
      as `SADA-Driving-OneCurve-v0`.
    - `agent="cil"`: a shipped driver (`cil`, `cil-augmented`, `ppo`), a file of weights that our
      training script wrote, or an SB3 model trained on `SADA-DrivingTask-v0`.
    - `agent_id=None`: names an in-memory model where scores are stored; by default a hash of its
      weights.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """  # noqa: E501 - a table's row

    name = "SADA-Driving"
    render_fps = POLICY_HZ
    frames_tell_values = True
    fooling_threshold = 0.6
    sample_size = 100
    episodes_class = DrivingEpisodes
    frame_module = "sada_gym.envs.driving.frame"
    behaviour_module = "sada_gym.envs.driving.behaviour"
    parameters = ParameterSpace(
        Parameter("camera_height_m", 1.0, 2.0, "m"),
        Parameter("camera_pitch_deg", -20.0, -10.0, "deg"),
        Parameter("weather", 0.0, float(len(NAMES)), choices=NAMES),
    )

    def __init__(
        self,
        task: str = "navigation",
        *,
        agent: AgentLike = "cil",
        agent_id: str | None = None,
    ) -> None:
        if not isinstance(task, str):
            raise UserTypeError(f"Expected a task's name, got {task!r}.")
        self.task, self.routes = task, benchmark_routes(task)
        super().__init__(agent, agent_id)

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {"task": self.task}

    def camera_and_weather(self, mu: Floats32) -> tuple[Mount, int]:
        """Return the camera's mount, and the weather's index, of one mu, (3,)."""
        height, pitch, place = self.parameters.physical(mu).tolist()
        return Mount(height, pitch), min(int(place), len(NAMES) - 1)

    def episodes(self, mu: Mu, seeds: Sequence[int]) -> DrivingEpisodes:
        """Begin all routes in the worlds of mu, five drives each: (5 n) of them."""
        starts = []
        for row, seed in zip(mu, seeds, strict=True):
            mount, weather = self.camera_and_weather(row)
            starts += [DrivingStart(route, mount, weather, seed) for route in self.routes]
        return DrivingEpisodes(camera(LAYOUT), starts)

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        # the seed fixes the rain alone: a dry world is the same for all, and is driven once
        worlds = [
            (mount, weather, seed if LIGHTS[weather].rain else None)
            for (mount, weather), seed in zip(map(self.camera_and_weather, mu), seeds, strict=True)
        ]
        first = {world: i for i, world in reversed([*enumerate(worlds)])}
        rows = sorted(first.values())
        ((_, drives),) = self._played(self.policy, mu[rows], [seeds[row] for row in rows])
        driven = [rows.index(first[world]) for world in worlds]
        shape = (len(rows), len(self.routes))
        ending = drives.ending.reshape(shape)[driven]
        progress = drives.progress_m.reshape(shape)[driven]
        lengths = [route.length_m for route in self.routes]
        extras = [
            {
                "weather": NAMES[weather],
                "endings": [DrivingEnd(code).name.lower() for code in codes],
                "progress": np.clip(made / lengths, 0.0, 1.0),
            }
            for (_, weather, _), codes, made in zip(worlds, ending, progress, strict=True)
        ]
        return Scored(drives.score.reshape(shape).mean(axis=1)[driven], extras)
