"""Self-driving in CARLA under attack: a camera's mount and the weather; Q is the arrivals."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from sada_gym.agents.contract import Agent, identity_of
from sada_gym.agents.identity import check_agent_id
from sada_gym.application import INVALID_SCORE, Application, Scored, validate_world
from sada_gym.envs.carla.connection import STEP_S, Servers, ServerWorld, client_library, session
from sada_gym.envs.carla.drive import Drive, DriveStart
from sada_gym.envs.carla.drivers import AUTOPILOT, Autopilot, as_driver
from sada_gym.envs.carla.routes import ROUTES, TASKS, TownRoute, find_routes
from sada_gym.envs.episodes.base import play
from sada_gym.errors import InvalidWorld, UserTypeError, check_integer, check_known
from sada_gym.foundations.arrays import Floats, Floats32
from sada_gym.foundations.behaviour import Behaviour, listed_events
from sada_gym.foundations.frames import Frame
from sada_gym.foundations.seeds import validate_seeds
from sada_gym.parameters import Parameter, ParameterSpace

PRESETS = (
    *("ClearNoon", "WetNoon", "HardRainNoon", "ClearSunset"),
    *("WetCloudyNoon", "SoftRainSunset"),
)
"""The paper's weathers, by CARLA's names."""
_MOUNT = (
    Parameter("camera_height_m", 1.0, 2.0, "m"),
    Parameter("camera_pitch_deg", -20.0, -10.0, "deg"),
)
_WEATHERS = {
    "presets": (Parameter("weather", 0.0, float(len(PRESETS)), choices=PRESETS),),
    "continuous": (
        Parameter("fog_percent", 0.0, 100.0, "%"),
        Parameter("rain_percent", 0.0, 100.0, "%"),
        Parameter("sun_altitude_deg", -10.0, 90.0, "deg"),
        Parameter("wetness_percent", 0.0, 100.0, "%"),
    ),
}
_NOMINAL = {"presets": (1.4, -15.0, 0.5), "continuous": (1.4, -15.0, 0.0, 0.0, 75.0, 0.0)}
_ENLARGED = 3
_TICKS_A_FRAME = 4


class CarlaDrivingApplication(Application):
    """A frozen driver with a camera drives five routes through a town of CARLA.

    ## Description
    The world is the SADA paper's: CARLA, on a server that you run. The driver gets the image of a
    camera at the front of its car, its speed, and at junctions a command that says where to go.
    The adversary mounts the camera and chooses the weather. The score Q is the share of the routes
    on which the car reaches its goal in time. CARLA does not repeat a drive to the bit: each
    route is driven `episodes` times, and the same mu can give another Q.

    ## Action Space
    `Box(-1, 1, (3,), float32)`, mapped linearly to:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | camera height | 1 | 2 | m |
    | 1 | camera pitch | -20 | -10 | deg |
    | 2 | weather, by sixths: ClearNoon, WetNoon, HardRainNoon, ClearSunset, WetCloudyNoon, SoftRainSunset | 0 | 6 | |

    With `weather="continuous"` it is `Box(-1, 1, (6,), float32)`; in the place of the preset:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 2 | fog | 0 | 100 | % |
    | 3 | rain | 0 | 100 | % |
    | 4 | altitude of the sun | -10 | 90 | deg |
    | 5 | wetness of the road | 0 | 100 | % |

    ## Observation Space
    `Box(-1, 1, (d + 2,), float32)`: last mu, last score, share of the steps left; zeros where there
    is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.6), `seed`, `parameters`, `weather` (the preset's name, or `continuous`),
    `endings` (for each drive `arrived`, `left_route` or `too_late`), `progress` (the share of each
    route that was driven) and `invalid` (why the server could not compute the world; else empty).

    ## Arguments
    - `task="navigation"`: `straight`, `one_curve` or `navigation`, five routes each.
    - `agent="autopilot"`: CARLA's traffic manager, which needs no camera and tries out a server. Or
      the file of an SB3 zip, a torch module in the convention of conditional imitation learning, an
      SB3 model, a function of an observation or an object with `predict`.
    - `agent_id=None`: names an in-memory driver where scores are stored; by default a hash of its
      weights, where they are known.
    - `host=None`: `HOST:PORT` of the server, or `HOST:PORT,PORT` of several, which workers share.
      None reads `SADA_CARLA_HOST`, and without it takes `localhost:2000`.
    - `town="Town01"`: a map of the server.
    - `weather="presets"`: or `continuous`, see above.
    - `episodes=3`: how often each route is driven.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """  # noqa: E501 - a table's row

    name = "SADA-DrivingCarla"
    render_fps = round(1 / STEP_S / _TICKS_A_FRAME)
    fooling_threshold = 0.6
    sample_size = 100
    parameters = ParameterSpace(*_MOUNT, *_WEATHERS["presets"])
    repeatable: ClassVar[bool] = False

    def __init__(
        self,
        task: str = "navigation",
        *,
        agent: Any = AUTOPILOT,
        agent_id: str | None = None,
        host: str | None = None,
        town: str = "Town01",
        weather: Literal["presets", "continuous"] = "presets",
        episodes: int = 3,
    ) -> None:
        check_known("task", [task], TASKS)
        check_known("weather", [weather], list(_WEATHERS))
        check_integer("episodes", episodes, 1, 1_000)
        if not isinstance(town, str):
            raise UserTypeError(f"Expected a town's name, such as 'Town01', got {town!r}.")
        check_agent_id(agent_id)
        self.task, self.town, self.weather, self.repeats = task, town, weather, int(episodes)
        self.servers = Servers.named(host)
        client_library()
        self.parameters = ParameterSpace(*_MOUNT, *_WEATHERS[weather])
        self.nominal = self.parameters.normalised(np.array(_NOMINAL[weather]))
        self.agent_name, self.agent, self.policy = as_driver(agent, agent_id)
        self._agent_id = agent_id
        self._routes: tuple[TownRoute, ...] = ()

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {
            "task": self.task,
            "town": self.town,
            "weather": self.weather,
            "episodes": self.repeats,
        }

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the driver's weights, or over its `agent_id` and how it is used."""
        return identity_of(self.policy, self.agent, self._agent_id)

    def evaluate_batch(self, mu: Floats32, seeds: Sequence[int]) -> Scored:
        results = [self._world(row, seed, self.policy) for row, seed in zip(mu, seeds, strict=True)]
        return Scored(np.array([score for score, _ in results]), [extra for _, extra in results])

    def _world(
        self, mu: Floats32, seed: int, driver: Agent[Drive, Any]
    ) -> tuple[float, dict[str, Any]]:
        """Drive all routes in the world of one mu, (d,): the score, and what else is told."""
        scores: list[float] = []
        progress = np.zeros(self.repeats * ROUTES)
        extra: dict[str, Any] = {"weather": self._weather_name(mu), "invalid": "", "endings": []}
        try:
            with (
                self._open(mu) as opened,
                closing(self._drives(opened, mu, seed, self.repeats)) as drives,
            ):
                for drive in drives:
                    play(driver, drive)
                    progress[len(scores)] = drive.progress
                    scores.append(float(drive.score[0]))
                    extra["endings"].append(drive.ending)
        except InvalidWorld as error:
            extra["invalid"] = error.reason
        score = INVALID_SCORE if extra["invalid"] else float(np.mean(scores))
        return score, {**extra, "progress": progress}

    @contextmanager
    def _open(self, mu: Floats32) -> Iterator[ServerWorld]:
        with session(self.servers, self.town) as opened:
            with opened.answering():
                town_map = opened.world.get_map()
            if not self._routes:
                self._routes = find_routes(town_map, self.task)
            with opened.answering():
                opened.world.set_weather(self._carla_weather(opened.carla, mu))
            yield opened

    def _drives(
        self, opened: ServerWorld, mu: Floats32, seed: int, repeats: int
    ) -> Generator[Drive, None, None]:
        """Begin one drive after another, `repeats` on each route."""
        height_m, pitch_deg, *_ = self.parameters.physical(mu).tolist()
        for state in np.random.SeedSequence(seed).generate_state(repeats).tolist():
            with opened.answering():
                opened.world.set_pedestrians_seed(state >> 1)
                opened.traffic.set_random_device_seed(state >> 1)
            for route in self._routes:
                with closing(Drive(opened, DriveStart(route, height_m, pitch_deg))) as drive:
                    yield drive

    def _weather_name(self, mu: Floats32) -> str:
        if self.weather == "continuous":
            return self.weather
        return PRESETS[min(int(self.parameters.physical(mu)[2]), len(PRESETS) - 1)]

    def _carla_weather(self, carla: Any, mu: Floats32) -> Any:
        if self.weather == "presets":
            return getattr(carla.WeatherParameters, self._weather_name(mu))
        fog, rain, sun_deg, wetness = self.parameters.physical(mu)[2:].tolist()
        weather = carla.WeatherParameters.ClearNoon
        changed = carla.WeatherParameters()
        for key in [key for key in dir(weather) if key.islower() and not key.startswith("_")]:
            setattr(changed, key, getattr(weather, key))
        changed.fog_density, changed.precipitation = fog, rain
        changed.cloudiness = max(weather.cloudiness, rain)  # it rains from clouds
        changed.sun_altitude_angle, changed.wetness = sun_deg, wetness
        changed.precipitation_deposits = wetness  # puddles
        return changed

    def privileged_score(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Floats | None:
        """Score CARLA's autopilot, which sees the whole world."""
        batch = self.parameters.validate(mu)
        checked = validate_seeds(seeds, len(batch))
        worlds = zip(batch, checked, strict=True)
        return np.array([self._world(row, seed, Autopilot())[0] for row, seed in worlds])

    def behaviour(self, info: Mapping[str, Any]) -> Behaviour:
        """Say which drives failed, and how."""
        drives = [
            {"route": 1 + i % ROUTES, "ending": ending, "driven": float(driven)}
            for i, (ending, driven) in enumerate(
                zip(info["endings"], info["progress"], strict=False)
            )
        ]
        events = []
        for drive in drives:
            if drive["ending"] != "arrived":
                event = drive["ending"].replace("_", " ").replace("left route", "left its route")
                events.append(
                    (f"route {drive['route']} {event} after {drive['driven']:.0%} of it", event)
                )
        text, told = listed_events(events, len(drives), "drive", "all drives arrived")
        return Behaviour(text, told, "drive", {"drives": drives})

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw what the camera sees at the start of the first route, enlarged."""
        (row,), seed = validate_world(self.parameters, mu, seed)
        with self._open(row) as opened, closing(self._drives(opened, row, seed, 1)) as drives:
            return _picture(next(drives)).repeat(_ENLARGED, axis=0).repeat(_ENLARGED, axis=1)

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Drive the routes again, once each: what the camera saw, and the share of arrivals."""
        (row,), seed = validate_world(self.parameters, mu, seed)
        frames: list[Frame] = []
        scores = []

        def keep(drive: Drive) -> None:
            if drive.steps[0] % _TICKS_A_FRAME == 0:
                frames.append(_picture(drive))

        with self._open(row) as opened, closing(self._drives(opened, row, seed, 1)) as drives:
            for drive in drives:
                play(self.policy, drive, keep)
                scores.append(float(drive.score[0]))
        return frames, float(np.mean(scores))


def _picture(drive: Drive) -> Frame:
    return np.asarray(drive.render(np.zeros(1, np.intp))[0])
