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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.env_checker import data_equivalence

from sada_gym.agents.built_in import BUILT_IN
from sada_gym.agents.remote.places import place_of
from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.application import GymnasiumApplication
from sada_gym.envs.wrapped.bindings import Attribute, Config, Keyword, ParameterBinding
from sada_gym.envs.wrapped.disturbances import ActionDelay, ObservationDelay, ObservationNoise
from sada_gym.envs.wrapped.factory import EnvFactory, has_time_limit
from sada_gym.envs.wrapped.inspection import has_one_engine
from sada_gym.envs.wrapped.paths import read
from sada_gym.envs.wrapped.scores import SUCCESS_KEYS, Episode, Success
from sada_gym.envs.wrapped.toml import KINDS, agent_of, find_modules_in
from sada_gym.errors import FileError, UserError, explained
from sada_gym.foundations.determinism import generators_kept, one_thread

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
    nominal: float = 0.0
    derived: Mapping[str, str] = field(default_factory=dict)
    """The attributes that follow from it, and their formulas, "" where unknown."""

    def __str__(self) -> str:
        """Write it as a line of a file."""
        settings = dict(self.binding.settings)
        kind = settings.pop("kind")
        value: Any = [settings["low"], settings["high"]]
        if kind not in ("Keyword", "Attribute") or [*settings] != ["low", "high"]:
            name = next(name for name, known in KINDS.items() if known is type(self.binding))
            value = {"kind": name, **settings}
        return _line(self.name, value) + (f"  # now {self.nominal:g}" if self.nominal else "")


_DELAY = _Candidate("action_delay", ActionDelay(0, 3, integer=True, unit="steps"))


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
        UserError: If the environment or the agent cannot be used.
    """
    folder = folder or Path()
    find_modules_in(folder)
    opened, named = _agent(str(agent), folder)
    factory, notes = EnvFactory(env_id, dict(env_kwargs or {}), max_steps), list[str]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with closing(factory.make({})) as env:
            if max_steps is None and not has_time_limit(env):
                factory = replace(factory, max_steps=LIMIT)
                said = f"{factory.name} has no TimeLimit, so the file ends an episode after"
                notes.append(f"{said} {LIMIT:,} steps.")
            proposed = _candidates(env, factory)
        num_envs = 1 if has_one_engine(factory) else None
        make = partial(
            GymnasiumApplication,
            env_id,
            fooling_threshold=0.5,
            max_steps=factory.max_steps,
            env_kwargs=factory.env_kwargs,
            agent_id="starter",
            num_envs=num_envs,
        )
        agents = _play(make, _DELAY, -1.0, agent=opened, count=EPISODES)
        chance: Sequence[Episode] = ()  # what acts inside the environment hears no actions
        if agent != BUILT_IN:
            chance = _play(make, _DELAY, -1.0, agent=_RandomActions(), count=EPISODES)
        known = [c for candidate in proposed if (c := _accepted(make, candidate)) is not None]
        chosen, others = _chosen(make, opened, known)
    score, threshold, about_score = _score(agents, chance)
    listed = ", ".join(candidate.name for candidate in chosen)
    ranges = "Ranges are half to twice the present values, of delays up to 3 steps: narrow them to"
    notes = [f"Parameters: {listed}. {ranges} what can happen.", *notes, *about_score]
    if num_envs is not None:
        named.append(_line("num_envs", num_envs))
        notes.append(f"A second {factory.name} in one process fails, so the file has num_envs = 1.")
    text = "\n".join(_lines(factory, named, score, threshold, chosen, others))
    return StarterFile(f"{text}\n", tuple(notes), threshold is not None)


def _agent(agent: str, folder: Path) -> tuple[Any, list[str]]:
    """Return the agent that a text means, and its lines in a file in a folder."""
    # a file's path and a program's parts are relative to the file that names them
    opened = agent_of(agent, Path.cwd() / "starter.toml")
    if isinstance(opened, Path):
        if not opened.is_file():
            raise FileError(f"Expected the file of an agent, got {agent}: no such file.")
        return opened, [_line("agent", Path(os.path.relpath(opened, folder)).as_posix())]
    if agent == BUILT_IN or place_of(agent, folder) is not None:
        return opened, [_line("agent", agent)]
    changed = "  # change it whenever the agent changes"
    return opened, [_line("agent", agent), _line("agent_id", agent) + changed]


def _chosen(
    make: Callable[..., GymnasiumApplication], agent: Any, known: Sequence[_Candidate]
) -> tuple[list[_Candidate], list[str]]:
    """Choose what changes an episode of the agent, and tell of all others in comments."""
    following = {path for candidate in known for path in candidate.derived}
    candidates = [c for c in known if c.name not in following and all(c.derived.values())]
    works, dead = list[_Candidate](), list[_Candidate]()
    for candidate in candidates:
        with suppress(UserError):  # a world that the environment cannot be in
            probe = partial(_play, make, candidate, agent=agent, max_steps=_PROBE_STEPS)
            (works if _differ(*probe(-1.0), *probe(1.0)) else dead).append(candidate)
    works.sort(key=lambda one: (not _PHYSICS.search(one.name), one.name))
    chosen = works[:MAX_PARAMETERS] or candidates[:1]
    others = [
        f"# {one}{'  # changed nothing when it was tried' if one in dead else ''}"
        for one in candidates
        if one not in chosen
    ]
    for one in known:
        unknown = " and ".join(path for path, text in one.derived.items() if not text)
        if one.name in following:
            others.append(f"# {one.name} follows from others")
        elif unknown:
            said = f"is left out: {unknown} would keep the value computed from it"
            others.append(f"# {one.name} {said}")
    return chosen, others


def _lines(
    factory: EnvFactory,
    agent: Sequence[str],
    score: str | list[Any],
    threshold: float | None,
    chosen: Sequence[_Candidate],
    others: Sequence[str],
) -> Iterator[str]:
    """Write the file, line by line."""
    yield "# A first guess by `sada-gym init`: look at every line before you trust a result."
    yield _line("environment", factory.identity)
    yield from agent
    yield _line("score", score)
    if threshold is None:
        yield "# fooling_threshold =   # choose one when the agent is better than random actions"
    else:
        yield _line("fooling_threshold", threshold)
    if factory.max_steps is not None:
        yield _line("max_steps", factory.max_steps)
    derived = {path: text for candidate in chosen for path, text in candidate.derived.items()}
    for title, lines in {
        "[env_kwargs]": [_line(*item) for item in factory.env_kwargs.items()],
        "[parameters]": [*map(str, chosen)],
        "[derived]  # what the constructor computed from the parameters": [
            _line(*item) for item in derived.items()
        ],
        "# Other parameters that it could have:": others,
    }.items():
        if lines:
            yield from ("", title, *lines)


def _line(key: str, value: Any) -> str:
    """Write a line of TOML."""
    if isinstance(value, dict):
        text = f"{{ {', '.join(_line(*item) for item in value.items())} }}"
    else:
        text = json.dumps(value)
    is_bare = re.fullmatch(r"[\w-]+", key, re.ASCII)
    return f"{key if is_bare else json.dumps(key)} = {text}"


def _play(
    make: Callable[..., GymnasiumApplication],
    candidate: _Candidate,
    end: float,
    *,
    agent: Any,
    count: int = 1,
    **options: Any,
) -> list[Episode]:
    """Play episodes with one parameter at an end of its range, and all others as they are."""
    record: list[Episode] = []

    def keep(episode: Episode) -> float:
        record.append(episode)
        return 0.0

    parameters, derived = {candidate.name: candidate.binding}, candidate.derived or None
    with closing(
        make(agent=agent, parameters=parameters, score=keep, derived=derived, **options)
    ) as application:
        application.evaluate(np.full((count, 1), end), range(count))
    return record[:count]  # then some are played again


def _differ(one: Episode, other: Episode) -> bool:
    same_rewards = np.array_equal(one.rewards, other.rewards)
    return not (same_rewards and data_equivalence(one.observations, other.observations))


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


def _candidates(env: gym.Env[Any, Any], factory: EnvFactory) -> list[_Candidate]:
    """List what can be set in an environment, and has a number other than zero now."""
    world: Any = env.unwrapped
    keywords = {**inspect.signature(type(world)).parameters, **factory.parameters}
    found = [
        _around(Keyword, name, name, keyword.default or 0.0)
        for name, keyword in keywords.items()
        if name not in factory.env_kwargs and _is_physics(name, keyword.default, or_zero=True)
    ]
    config = getattr(world, "config", None)
    entries = _entries(config if isinstance(config, dict) else {})
    found += [_around(Config, path, path, value) for path, value in entries]
    of_class = [n for kind in type(world).__mro__ for n, v in vars(kind).items() if is_number(v)]
    paths = {name: name for name in (*vars(world), *of_class) if name[0] != "_"}
    model: Any = getattr(world, "model", None)
    if hasattr(model, "opt") and hasattr(model, "body_mass"):  # MuJoCo's
        paths["gravity"] = "model.opt.gravity[2]"
        heaviest = np.argsort(-np.asarray(model.body_mass), kind="stable")[:2].tolist()
        paths |= {f"{model.body(i).name}_mass": f"model.body_mass[{i}]" for i in heaviest}
    values = {path: _at(world, path) for path in paths.values()}
    seen = _play_at_random(env)
    for name, path in paths.items():
        value = values[path]
        if not _is_physics(name, value) or _at(world, path) != value:  # an episode changes it
            continue
        if path.startswith("model.body_mass"):  # inertia goes with mass
            both = (path, path.replace("mass", "inertia"))
            found.append(_Candidate(name, Attribute(0.5, 2.0, paths=both, factor=True), 1.0))
        else:
            found.append(_around(Attribute, name, path, value))
    space = env.observation_space
    if isinstance(space, gym.spaces.Box) and len(space.shape) == 1:
        spread = np.std(np.asarray(seen, float), axis=0)
        typical = np.median(spread[spread > 0]) if spread.any() else 0.2
        found.append(_Candidate("noise", ObservationNoise(0.0, float(f"{0.5 * typical:.2g}"))))
    late = ObservationDelay(0, 3, integer=True, unit="steps")
    by_name = dict[str, _Candidate]()
    for candidate in (*found, _Candidate("observation_delay", late), _DELAY):
        by_name.setdefault(candidate.name, candidate)
    return [*by_name.values()]


def _entries(config: Mapping[Any, Any], within: str = "") -> Iterator[tuple[str, Any]]:
    """List the numbers in a configuration, and in dictionaries and lists within it, by path."""
    for key, value in config.items():
        is_word = isinstance(key, str) and key.isidentifier()
        path = f"{within}{key}"
        if is_word and isinstance(value, Mapping):
            yield from _entries(value, f"{path}.")
        elif is_word and isinstance(value, list):
            inside = [(f"{path}[{i}]", item) for i, item in enumerate(value)]
            yield from (entry for entry in inside if _is_physics(*entry))
        elif (is_word or (isinstance(key, str) and not within)) and _is_physics(path, value):
            yield path, value


def _play_at_random(env: gym.Env[Any, Any]) -> list[Any]:
    """Take a hundred random actions, and return what was observed."""
    seen = [env.reset(seed=0)[0]]
    env.action_space.seed(0)
    for _ in range(_PROBE_STEPS):
        observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
        seen.append(observation)
        if terminated or truncated:
            seen.append(env.reset()[0])
    return seen


def _at(world: Any, path: str) -> Any:
    value = read(world, path)
    return value.item() if isinstance(value, np.generic) else value


def _is_physics(name: str, value: Any, *, or_zero: bool = False) -> bool:
    """Say whether a number may be one of physics.

    One that is zero now has to sound so, such as `wind_power` or `payload`.
    """
    name = name.lower()
    is_finite = is_number(value) and math.isfinite(value)
    if not is_finite or _NO_PHYSICS.search(name):
        return False
    return bool(value) or (or_zero and bool(_PHYSICS.search(name)))


def _around(kind: Any, name: str, path: str, value: float) -> _Candidate:
    """Propose half to twice a value, of zero up to one; whole numbers stay whole."""
    name = re.sub(r"\W", "_", name)
    target = {} if path == name else {"name" if kind is Config else "paths": path}
    low, high = sorted((value / 2, value * 2 or 1.0))
    if isinstance(value, int):
        whole = kind(math.floor(low), math.ceil(high), integer=True, **target)
        return _Candidate(name, whole, float(value))
    return _Candidate(name, kind(_rounded(low, 3), _rounded(high, 3), **target), float(value))


def _accepted(
    make: Callable[..., GymnasiumApplication], candidate: _Candidate
) -> _Candidate | None:
    """Return a candidate with a range that the environment takes, narrowed if need be; or None."""
    value, bindings = candidate.nominal, [candidate.binding]
    for factor in _NARROWER if value and not candidate.binding.integer else ():
        low, high = sorted((_rounded(value / factor, 3), _rounded(value * factor, 3)))
        bindings.append(replace(candidate.binding, low=low, high=high))
    for binding in bindings:
        with suppress(UserError):
            parameters = {candidate.name: binding}
            tried = make(agent=_RandomActions(), parameters=parameters, score=("length", 1))
            return replace(candidate, binding=binding, derived=tried.stale)
    return None


def _rounded(value: float, digits: int, towards: Callable[[float], float] = round) -> float:
    """Round to so many digits, to the nearest, down or up."""
    step = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - digits) if value else 1.0
    return float(f"{towards(value / step) * step:.6g}")


def _score(
    agents: Sequence[Episode], chance: Sequence[Episode]
) -> tuple[str | list[Any], float | None, list[str]]:
    """Choose a score and a threshold, None where the agent is no good, and say why.

    Without episodes of random actions, the threshold lies halfway to the lowest score.
    """
    succeed = all({*SUCCESS_KEYS} & {*episode.infos[-1]} for episode in (*agents, *chance))
    worth = (lambda episode: Success()(episode)[0]) if succeed else (lambda one: one.total)
    ours, random = (np.array([worth(one) for one in some], float) for some in (agents, chance))
    middle = np.mean if succeed else np.median
    good, bad = float(middle(ours)), float(middle(random)) if chance else 0.0
    score: str | list[Any] = "success"
    threshold = limit = 0.5
    if succeed:
        notes = [
            f'Score: "success". The agent succeeds in {good:.0%} of {EPISODES} nominal episodes'
            + (f", random actions in {bad:.0%}." if chance else ".")
        ]
    else:
        worst, best = float(min(*ours, *random)), float(max(*ours, *random))
        margin = 0.5 * (best - worst) or 1.0
        rewards = np.concatenate([episode.rewards for episode in (*agents, *chance)])
        low = 0.0 if (rewards >= 0).all() else _rounded(worst - margin, 2, math.floor)
        # rewards that never differ have a best return: that of the longest episode
        same = len(set(rewards.tolist())) == 1 and best > low
        high = best if same else _rounded(best + margin, 2, math.ceil)
        score = ["return", low, high]
        bad = bad if chance else low
        threshold = round(((good + bad) / 2 - low) / (high - low), 2)
        limit = low + threshold * (high - low)
        notes = [
            f"Score: the return, from {low:g} to {high:g}. In {EPISODES} nominal episodes the "
            f"agent gets {ours.min():.4g} to {ours.max():.4g}"
            + (
                f", random actions {random.min():.4g} to {random.max():.4g}."
                if len(random)
                else "."
            ),
            f"Threshold {threshold:g}: a return of at most {limit:.4g} counts as a failure, "
            f"halfway between the agent and {'random actions' if chance else 'the lowest score'}.",
        ]
    if good <= bad:
        return score, None, [notes[0], _NO_BETTER]
    if (failing := np.mean(ours <= limit)) > 0.2:
        notes.append(
            f"The agent fails in {failing:.0%} of nominal episodes already: an attack says little "
            "until it is better, or the threshold lower."
        )
    return score, threshold, notes


_NO_BETTER = (
    "The agent does no better than random actions, so the file has no threshold, and no attack on "
    "it would say anything: train it longer, or check that it belongs to this environment."
)


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
