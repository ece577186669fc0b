"""Writes a first TOML file for an environment: what may change in it, a score and a threshold.

It looks at the environment and tries things out. All of it is a guess, and the file says so.
"""

from __future__ import annotations

import inspect
import json
import math
import os
import re
import warnings
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.env_checker import data_equivalence

from sada_gym.agents.remote.places import place_of
from sada_gym.arrays import Floats
from sada_gym.determinism import generators_kept, one_thread
from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.application import GymnasiumApplication
from sada_gym.envs.wrapped.bindings import Attribute, Config, Keyword, ParameterBinding
from sada_gym.envs.wrapped.disturbances import ActionDelay, ObservationDelay, ObservationNoise
from sada_gym.envs.wrapped.factory import EnvFactory, has_time_limit
from sada_gym.envs.wrapped.paths import read
from sada_gym.envs.wrapped.scores import SUCCESS_KEYS, Episode, Success
from sada_gym.envs.wrapped.toml import KINDS, agent_of, find_modules_in
from sada_gym.errors import FileError, UserError, explained

EPISODES = 20
"""Nominal episodes of the agent, and as many of random actions, that a guess rests on."""

LIMIT = 1000
"""The limit of steps where an environment has no `TimeLimit` and the user names none."""

MAX_PARAMETERS = 6
"""Parameters that a file proposes; others stand in it as comments."""

_PROBE_STEPS = 100
_NARROWER = (1.5, 1.2, 1.1)
"""Factors of the present value, where half to twice is refused."""
_NO_PHYSICS = re.compile(
    r"render|screen|viewport|fps|window|width|height|camera|seed|reward|score|bonus|weight|cost|"
    r"step|frequency|duration|time|count|prev|last|max_|min_|threshold|dim|size|n_|num_|id$|"
    r"offset|scaling|range|healthy|exclude|terminate|frame|metadata|dtype|destination|success"
)
_PHYSICS = re.compile(
    r"gravity|mass|friction|damp|force|power|wind|turbulence|torque|density|speed|vel|length|"
    r"^[glm]\d?$|magnitude|noise|delay|slip|size|drag|stiff|"
    r"gust|payload|load|slope|tilt|bias|drift"
)


@dataclass(frozen=True)
class _Candidate:
    """A parameter that a file may have: what it sets, and the value that the environment has."""

    name: str
    binding: ParameterBinding
    nominal: float
    derived: Mapping[str, str] = field(default_factory=dict)
    """The attributes that follow from it, and their formulas, "" where unknown."""

    @property
    def rank(self) -> tuple[bool, str]:
        """What sounds like physics comes first."""
        return not _PHYSICS.search(self.name), self.name


@dataclass(frozen=True)
class StarterFile:
    """A first TOML file: its text, what was guessed, a sentence each, and if it can be attacked."""

    text: str
    notes: tuple[str, ...]
    ready: bool


def starter_file(
    env_id: str,
    agent: str | Path,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    max_steps: int | None = None,
    folder: Path | None = None,
) -> StarterFile:
    """Look at an environment and write a TOML file with which its agent can be attacked at once.

    Parameters are numeric keywords of the constructor, attributes, MuJoCo's masses and gravity, and
    a configuration's entries, each from half to twice its value, as far as they change an episode;
    and delays and noise. Score and threshold come from `EPISODES` nominal episodes of the agent and
    as many of random actions.

    Args:
        env_id: The environment's id, or `module:id`.
        agent: The agent as a TOML file names it, but a file relative to the working directory.
        env_kwargs: Keywords that every environment gets.
        max_steps: The limit of steps of an episode; None keeps the environment's own, or takes
            `LIMIT` where it has no `TimeLimit`.
        folder: Where the file will lie: the agent's path is written relative to it.

    Raises:
        UserError: If the environment or the agent cannot be used, or nothing can be changed.
    """
    folder = folder or Path()
    find_modules_in(folder)
    # a file's path and a program's parts are relative to the file that names them
    opened = agent_of(str(agent), Path.cwd() / "starter.toml")
    named = str(agent)
    if isinstance(opened, Path):
        if not opened.is_file():
            raise FileError(f"Expected the file of an agent, got {agent}: no such file.")
        named = Path(os.path.relpath(opened, folder)).as_posix()
    is_imported = not isinstance(opened, Path) and place_of(named, folder) is None
    keywords = dict(env_kwargs or {})
    factory, limits = _limited(EnvFactory(env_id, keywords, max_steps))
    make = partial(
        GymnasiumApplication,
        env_id,
        fooling_threshold=0.5,
        max_steps=factory.max_steps,
        env_kwargs=keywords,
        agent_id="starter",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        proposed = [_accepted(make, candidate) for candidate in _candidates(factory)]
        known = [candidate for candidate in proposed if candidate is not None]
        following = {path for candidate in known for path in candidate.derived}
        candidates = [c for c in known if c.name not in following and all(c.derived.values())]
        if not candidates:
            raise UserError(
                f"Expected something in {factory.name} that a parameter can set, got nothing. "
                "Write the file by hand, with a function of your own: see own-agent.md."
            )
        trials = _Trials(make, opened, candidates)
        works = [c for c in candidates if trials.changes(c)]
        agents, chance = trials.nominal(), trials.at_random()
    chosen = sorted(works, key=lambda candidate: candidate.rank)[:MAX_PARAMETERS] or candidates[:1]
    score, threshold, notes = _score(agents, chance)
    others = [c for c in candidates if c not in chosen]
    text = _toml(
        factory, _agent_lines(named, is_imported), score, threshold, chosen, others, trials.dead
    )
    text += "".join(_why(c, following) for c in known if c not in candidates)
    listed = ", ".join(candidate.name for candidate in chosen)
    ranges = "Ranges are half to twice the present values, of delays up to 3 steps: narrow them to"
    notes = (f"Parameters: {listed}. {ranges} what can happen.", *limits, *notes)
    return StarterFile(text, notes, threshold is not None)


def _limited(factory: EnvFactory) -> tuple[EnvFactory, list[str]]:
    """Return a factory whose episodes have a limit of steps, and what was guessed."""
    if factory.max_steps is not None:
        return factory, []
    with closing(factory.make({})) as env:
        if has_time_limit(env):
            return factory, []
    note = f"{factory.name} has no TimeLimit, so the file ends an episode after {LIMIT:,} steps."
    return replace(factory, max_steps=LIMIT), [note]


class _Trials:
    """Episodes of the agent in the nominal world, and in worlds that differ in one parameter."""

    def __init__(
        self, make: Callable[..., GymnasiumApplication], agent: Any, candidates: list[_Candidate]
    ) -> None:
        self.dead: list[str] = []
        self._make, self._agent, self._candidates = make, agent, candidates

    def changes(self, candidate: _Candidate) -> bool:
        """Say whether the two ends of a parameter's range differ in what happens."""
        try:
            low, high = (self.play(_PROBE_STEPS, candidate, end)[0] for end in (-1.0, 1.0))
        except UserError:  # a world that the environment cannot be in
            return False
        changed = _differs(low, high)
        if not changed:
            self.dead.append(candidate.name)
        return changed

    def nominal(self) -> list[Episode]:
        """Return nominal episodes of the agent."""
        return self.play(None, count=EPISODES)

    def at_random(self) -> list[Episode]:
        """Return nominal episodes of random actions."""
        return self.play(None, count=EPISODES, agent=_RandomActions())

    def play(
        self,
        max_steps: int | None,
        candidate: _Candidate | None = None,
        end: float = 0.0,
        *,
        count: int = 1,
        agent: Any = None,
    ) -> list[Episode]:
        """Play episodes; all parameters have their nominal values, but one may be at an end."""
        record: list[Episode] = []

        def keep(episode: Episode) -> float:
            record.append(episode)
            return 0.0

        moved = candidate or self._candidates[0]
        options = {} if max_steps is None else {"max_steps": max_steps}
        application = self._make(
            agent=agent or self._agent,
            parameters={moved.name: moved.binding},
            score=keep,
            derived=moved.derived or None,
            **options,
        )
        with closing(application):
            mu = np.array([[end]])
            if candidate is None:
                mu = application.parameters.normalised(np.array([[moved.nominal]]))
            application.evaluate(np.repeat(mu, count, axis=0), range(count))
        return record


class _RandomActions:
    """Draws every action from the action space, by the seed of its episode."""

    fingerprint = None

    def start(self, count: int) -> None:
        """Remember nothing."""

    def act(self, episodes: Any, which: Any) -> list[Any]:
        space = episodes.action_space
        actions = []
        for seed in episodes.agent_seeds(which).tolist():
            space.seed(seed)
            actions.append(space.sample())
        return actions


def _candidates(factory: EnvFactory) -> Iterator[_Candidate]:
    """List what can be set in an environment and has a number other than zero now."""
    with closing(factory.make({})) as env:
        world: Any = env.unwrapped
        known = set[str]()
        for name, value in _keywords(type(world), factory).items():
            known.add(name)
            yield _around(name, Keyword, value or 0.0)
        config = getattr(world, "config", None)
        for name, value in _entries(config if isinstance(config, dict) else {}):
            word = re.sub(r"\W", "_", name)
            if _is_physics(name, value) and word not in known:
                known.add(word)
                target = {} if word == name else {"name": name}
                yield _around(name, Config, value, **target)
        for name, (path, value) in _steady(env, world).items():
            if path.startswith("model.body_mass"):  # inertia goes with mass
                both = (path, path.replace("mass", "inertia"))
                yield _Candidate(name, Attribute(0.5, 2.0, paths=both, factor=True), 1.0)
            elif name not in known:
                target = {} if path == name else {"paths": path}
                yield _around(name, Attribute, value, **target)
        space = env.observation_space
        if isinstance(space, gym.spaces.Box) and len(space.shape) == 1:
            yield _Candidate("noise", ObservationNoise(0.0, _noise(env)), 0.0)
    yield _Candidate("observation_delay", ObservationDelay(0, 3, integer=True, unit="steps"), 0.0)
    yield _Candidate("action_delay", ActionDelay(0, 3, integer=True, unit="steps"), 0.0)


def _entries(config: Mapping[Any, Any]) -> Iterator[tuple[str, Any]]:
    """List what stands in a configuration, and in dictionaries and lists within it, by path."""
    for key, value in config.items():
        if isinstance(value, Mapping) and _is_word(key):
            inside = _entries({name: item for name, item in value.items() if _is_word(name)})
            yield from ((f"{key}.{name}", item) for name, item in inside)
        elif isinstance(value, list) and _is_word(key):
            yield from ((f"{key}[{i}]", item) for i, item in enumerate(value))
        elif isinstance(key, str):
            yield key, value


def _is_word(key: Any) -> bool:
    return isinstance(key, str) and key.isidentifier()


def _keywords(kind: type, factory: EnvFactory) -> dict[str, float]:
    given = {name: p.default for name, p in inspect.signature(kind).parameters.items()}
    given |= {name: p.default for name, p in factory.parameters.items()}
    return {
        name: value
        for name, value in given.items()
        if name not in factory.env_kwargs
        and (_is_physics(name, value) or (_is_number(value) and not value and _sounds(name)))
    }


def _steady(env: gym.Env[Any, Any], world: Any) -> dict[str, tuple[str, float]]:
    """List the numbers of an environment that an episode leaves as they are: name, path, value."""
    kinds = type(world).__mro__
    of_class = [name for kind in kinds for name, value in vars(kind).items() if is_number(value)]
    paths = {name: name for name in (*vars(world), *of_class) if name[0] != "_"}
    model: Any = getattr(world, "model", None)
    if hasattr(model, "opt") and hasattr(model, "body_mass"):  # MuJoCo's
        paths["gravity"] = "model.opt.gravity[2]"
        heaviest = np.argsort(-np.asarray(model.body_mass), kind="stable")[:2].tolist()
        paths |= {f"{model.body(i).name}_mass": f"model.body_mass[{i}]" for i in heaviest}
    before = {
        name: (path, value)
        for name, path in paths.items()
        if _is_physics(name, value := _at(world, path))
    }
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(20):
        if any(env.step(env.action_space.sample())[2:4]):
            break
    return {name: row for name, row in before.items() if _at(world, row[0]) == row[1]}


def _at(world: Any, path: str) -> Any:
    value = read(world, path)
    return value.item() if isinstance(value, np.generic) else value


def _is_physics(name: str, value: Any) -> bool:
    return bool(_is_number(value) and value) and not _NO_PHYSICS.search(name.lower())


def _is_number(value: Any) -> bool:
    return is_number(value) and not isinstance(value, bool) and math.isfinite(value)


def _sounds(name: str) -> bool:
    """Whether a number that is zero now sounds like physics, such as `wind_power` or `payload`."""
    name = name.lower()
    return bool(_PHYSICS.search(name)) and not _NO_PHYSICS.search(name)


def _around(name: str, /, kind: Any, value: float, **target: str) -> _Candidate:
    """Propose half to twice a value, of zero up to one; whole numbers stay whole."""
    low, high = sorted((value / 2, value * 2 or 1.0))
    name = re.sub(r"\W", "_", name)
    if isinstance(value, int):
        whole = kind(math.floor(low), math.ceil(high), integer=True, **target)
        return _Candidate(name, whole, float(value))
    return _Candidate(name, kind(_short(low), _short(high), **target), float(value))


def _short(value: float) -> float:
    return float(f"{value:.3g}")


def _noise(env: gym.Env[Any, Any]) -> float:
    """Half the typical spread of an observation's entries under random actions."""
    seen = [env.reset(seed=0)[0]]
    for _ in range(100):
        observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
        seen.append(observation)
        if terminated or truncated:
            seen.append(env.reset()[0])
    spread = np.std(np.asarray(seen, float), axis=0)
    moving = spread[spread > 0]
    return float(f"{0.5 * np.median(moving):.2g}") if len(moving) else 0.1


def _accepted(
    make: Callable[..., GymnasiumApplication], candidate: _Candidate
) -> _Candidate | None:
    """Return a candidate with a range that the environment takes, narrowed if need be; or None."""
    value, binding = candidate.nominal, candidate.binding
    narrower = () if binding.integer or not value else _NARROWER
    for factor in (None, *narrower):
        if factor is not None:
            low, high = sorted((_short(value / factor), _short(value * factor)))
            binding = replace(binding, low=low, high=high)
        try:
            application = make(
                agent=_RandomActions(), parameters={candidate.name: binding}, score=("length", 1)
            )
        except UserError:
            continue
        return replace(candidate, binding=binding, derived=application.stale)
    return None


def _differs(one: Episode, other: Episode) -> bool:
    same_rewards = np.array_equal(one.rewards, other.rewards)
    return not (same_rewards and data_equivalence(one.observations, other.observations))


def _score(
    agents: Sequence[Episode], chance: Sequence[Episode]
) -> tuple[str, float | None, tuple[str, ...]]:
    """Choose a score and a threshold, None where the agent is no good, and say why."""
    if all({*SUCCESS_KEYS} & {*episode.infos[-1]} for episode in (*agents, *chance)):
        rate = np.mean([Success()(episode)[0] for episode in agents])
        luck = np.mean([Success()(episode)[0] for episode in chance])
        said = (
            f'Score: "success". The agent succeeds in {rate:.0%} of {EPISODES} nominal episodes, '
            f"random actions in {luck:.0%}."
        )
        if rate <= luck:
            return json.dumps("success"), None, (said, _NO_BETTER)
        return json.dumps("success"), 0.5, (said, *_doubt(float(1 - rate)))
    ours, random = _returns(agents), _returns(chance)
    good, bad = float(np.median(ours)), float(np.median(random))
    worst, best = float(min(ours.min(), random.min())), float(max(ours.max(), random.max()))
    margin = 0.5 * (best - worst) or 1.0
    rewards = np.concatenate([episode.rewards for episode in (*agents, *chance)])
    low = 0.0 if (rewards >= 0).all() else _rounded(worst - margin, math.floor)
    # rewards that never differ have a best return: that of the longest episode
    high = best if len(set(rewards.tolist())) == 1 else _rounded(best + margin, math.ceil)
    text = f'["return", {low!r}, {high!r}]'
    threshold = round(((good + bad) / 2 - low) / (high - low), 2)
    limit = low + threshold * (high - low)
    notes = [
        f"Score: the return, from {low:g} to {high:g}. In {EPISODES} nominal episodes the agent "
        f"gets {ours.min():.4g} to {ours.max():.4g}, random actions {random.min():.4g} to "
        f"{random.max():.4g}.",
    ]
    if good <= bad:
        return text, None, (*notes, _NO_BETTER)
    notes.append(
        f"Threshold {threshold:g}: a return of at most {limit:.4g} counts as a failure, halfway "
        "between the agent and random actions."
    )
    return text, threshold, (*notes, *_doubt(float(np.mean(ours <= limit))))


_NO_BETTER = (
    "The agent does no better than random actions, so the file has no threshold, and no attack on "
    "it would say anything: train it longer, or check that it belongs to this environment."
)


def _doubt(failing: float) -> list[str]:
    if failing <= 0.2:
        return []
    return [
        f"The agent fails in {failing:.0%} of nominal episodes already: an attack says little "
        "until it is better, or the threshold lower."
    ]


def _returns(episodes: Sequence[Episode]) -> Floats:
    return np.array([episode.total for episode in episodes])


def _rounded(value: float, towards: Callable[[float], int]) -> float:
    """Round to two digits, down or up."""
    step = 10.0 ** (math.floor(math.log10(abs(value))) - 1) if value else 1.0
    return float(f"{towards(value / step) * step:.6g}")


def _toml(
    factory: EnvFactory,
    agent: Sequence[str],
    score: str,
    threshold: float | None,
    chosen: Sequence[_Candidate],
    others: Sequence[_Candidate],
    dead: Sequence[str],
) -> str:
    lines = [
        "# A first guess by `sada-gym init`: look at every line before you trust a result.",
        f"environment = {json.dumps(factory.identity)}",
        *agent,
        f"score = {score}",
        "# fooling_threshold =   # choose one when the agent is better than random actions"
        if threshold is None
        else f"fooling_threshold = {threshold!r}",
    ]
    if factory.max_steps is not None:
        lines.append(f"max_steps = {factory.max_steps}")
    if factory.env_kwargs:
        given = [f"{_key(key)} = {json.dumps(value)}" for key, value in factory.env_kwargs.items()]
        lines += ["", "[env_kwargs]", *given]
    lines += ["", "[parameters]", *map(_line, chosen)]
    derived = {path: text for candidate in chosen for path, text in candidate.derived.items()}
    if derived:
        lines += ["", "[derived]  # what the constructor computed from the parameters"]
        lines += [f"{_key(path)} = {json.dumps(text)}" for path, text in derived.items()]
    if others:
        lines += ["", "# Other parameters that it could have:"]
    for candidate in others:
        note = "  # changed nothing when it was tried" if candidate.name in dead else ""
        lines.append(f"# {_line(candidate)}{note}")
    return "\n".join(lines) + "\n"


def _agent_lines(named: str, is_imported: bool) -> list[str]:
    lines = [f"agent = {json.dumps(named)}"]
    if is_imported:
        lines.append(f"agent_id = {json.dumps(named)}  # change it whenever the agent changes")
    return lines


def _why(candidate: _Candidate, following: Container[str]) -> str:
    """Say why a parameter is not proposed."""
    unknown = " and ".join(path for path, text in candidate.derived.items() if not text)
    return (
        f"# {candidate.name} follows from others\n"
        if candidate.name in following
        else f"# {candidate.name} is left out: {unknown} would keep the value computed from it\n"
    )


def _line(candidate: _Candidate) -> str:
    settings = {key: value for key, value in candidate.binding.settings.items() if key != "kind"}
    kind = next(name for name, known in KINDS.items() if known is type(candidate.binding))
    text = f"{_key(candidate.name)} = [{settings['low']}, {settings['high']}]"
    if kind not in ("keyword", "attribute") or [*settings] != ["low", "high"]:
        table = [f'kind = "{kind}"']
        table += [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
        text = f"{_key(candidate.name)} = {{ {', '.join(table)} }}"
    return text if candidate.nominal == 0.0 else f"{text}  # now {candidate.nominal:g}"


def _key(name: str) -> str:
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else json.dumps(name)


def train_stand_in(
    env_id: str,
    path: Path,
    steps: int,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    max_steps: int | None = None,
) -> None:
    """Train an SB3 agent for a while, with the library's own settings, and save it as a zip.

    It stands in for an agent of the user's. It is a PPO, which can act in most environments. Raises
    `UserError` if the environment cannot be made, or PPO cannot learn in it.
    """
    from stable_baselines3 import PPO

    factory = EnvFactory(env_id, dict(env_kwargs or {}), max_steps)
    with closing(factory.make({})) as env:
        is_dictionary = isinstance(env.observation_space, gym.spaces.Dict)
        with explained(
            f"Expected PPO of Stable-Baselines3 to learn in {factory.name}",
            "Train an agent yourself, and name it by --agent.",
        ):
            policy = "MultiInputPolicy" if is_dictionary else "MlpPolicy"
            with one_thread(), generators_kept():
                PPO(policy, env, seed=0, device="cpu").learn(steps).save(path)
