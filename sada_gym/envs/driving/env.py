"""SADA-Driving as Gymnasium environments: a driver attacked through its camera and the weather."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sada_gym.agents.wrappers import Predictor
from sada_gym.envs.adversary import AdversaryEnv, AdversaryVectorEnv
from sada_gym.envs.driving.application import DrivingApplication
from sada_gym.envs.driving.episodes import POLICY_HZ


class DrivingEnv(AdversaryEnv):
    """A frozen driver with a camera drives five routes through a town.

    ## Description
    The driver gets the image of a camera at the front of its car, its speed, and at junctions a
    command that says where to go. The adversary mounts the camera and chooses the weather; the
    score Q is the share of the five routes on which the car arrives in time without leaving its
    lane. The car is highway-env's. Town, light and weather are our own procedures: it is not CARLA. The
    seed fixes the rain, so that Q is random in the two rainy weathers only.

    ## Action Space
    `Box(-1, 1, (3,), float32)`, linear in:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | camera height | 1 | 2 | m |
    | 1 | camera pitch | -20 | -10 | deg |
    | 2 | weather, by sixths: ClearNoon, WetNoon, HardRainNoon, ClearSunset, WetCloudyNoon, SoftRainSunset | 0 | 6 | |

    The drivers were trained at 1.4 m, -15° and in the first four weathers.

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
    - `agent_id=None`: names an in-memory model in evaluation stores; by default a hash of its
      weights.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """  # noqa: E501 - a table's row

    metadata: dict[str, Any] = {**AdversaryEnv.metadata, "render_fps": POLICY_HZ}  # noqa: RUF012

    def __init__(
        self,
        task: str = "navigation",
        *,
        agent: str | Path | Predictor = "cil",
        agent_id: str | None = None,
        horizon: int = 1,
        render_mode: str | None = None,
    ) -> None:
        application = DrivingApplication(task, agent=agent, agent_id=agent_id)
        super().__init__(application, horizon=horizon, render_mode=render_mode)


class DrivingVectorEnv(AdversaryVectorEnv):
    """`DrivingEnv` in a batch: all cars of all worlds drive in lockstep."""

    metadata: dict[str, Any] = {**AdversaryVectorEnv.metadata, "render_fps": POLICY_HZ}  # noqa: RUF012

    def __init__(
        self,
        task: str = "navigation",
        *,
        num_envs: int = 1,
        agent: str | Path | Predictor = "cil",
        agent_id: str | None = None,
        horizon: int = 1,
        render_mode: str | None = None,
    ) -> None:
        application = DrivingApplication(task, agent=agent, agent_id=agent_id)
        super().__init__(application, num_envs=num_envs, horizon=horizon, render_mode=render_mode)
