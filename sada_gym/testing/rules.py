"""The rules for applications. Each function checks one and raises AssertionError."""

from __future__ import annotations

import math
import pickle
import random
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.utils.env_checker import data_equivalence

from sada_gym.application import RESERVED_KEYS, Application
from sada_gym.envs.adversary import AdversaryEnv
from sada_gym.envs.checks import MAX_TILE
from sada_gym.parameters import ParameterSpace
from sada_gym.testing.purity import assert_pure, assert_same_in_another_process, draw_worlds

SIZES = (2, 3, 7, 15, 16, 17, 31, 33, 64)
"""Batch sizes that test purity: around one, two and four tiles of 16."""
_WORLDS, _ALONE = 34, 8
"""Worlds that test purity, and those of them that are evaluated alone, which costs most."""


def _require(condition: bool, sentence: str) -> None:
    if not condition:
        raise AssertionError(sentence)


def check_declaration(application: Application) -> str:
    """Check the attributes that describe the application."""
    parameters = getattr(application, "parameters", None)
    _require(
        isinstance(parameters, ParameterSpace),
        f"Expected `parameters` to be a ParameterSpace, got {parameters!r}. Set it in __init__ or "
        "in the class.",
    )
    name = getattr(application, "name", None)
    _require(isinstance(name, str) and bool(name), f"Expected `name` to be a str, got {name!r}.")
    threshold = getattr(application, "fooling_threshold", None)
    _require(
        isinstance(threshold, float | int) and 0.0 <= threshold <= 1.0,
        f"Expected `fooling_threshold` in [0, 1], got {threshold!r}.",
    )
    size = getattr(application, "sample_size", None)
    _require(
        isinstance(size, int) and size >= 1,
        f"Expected `sample_size` to be an int of at least 1, got {size!r}.",
    )
    return f"{len(application.parameters)} parameters: {', '.join(application.parameters.names)}."


def check_outcomes(application: Application, *, n: int = 32) -> str:
    """Check the scores and infos of n worlds: the same keys, finite values that can be batched."""
    mu, seeds = draw_worlds(application, n, seed=1)
    outcomes = application.evaluate(mu, seeds)
    first = _shape_of(outcomes.infos[0])
    for i, info in enumerate(outcomes.infos):
        _require(
            info.keys() >= RESERVED_KEYS and info["score"] == outcomes.score[i],
            f"Expected info with {sorted(RESERVED_KEYS)}, got {sorted(info)}. Do not override "
            "`evaluate`.",
        )
        _require(
            _shape_of(info) == first,
            f"Expected every info to have the keys and types {first}, got {_shape_of(info)} for "
            f"world {i}. Give each key in every world, always of one type and array shape.",
        )
        _require(_is_finite(info), f"Expected no NaN and no infinity in info, got {info}.")
    low, high = outcomes.score.min(), outcomes.score.max()
    share = outcomes.fooled.mean()
    return f"Scores from {low:.3g} to {high:.3g}; {share:.0%} of uniform mu fool the agent."


def check_randomness(application: Application) -> str:
    """Check that scores come from the seeds alone and no global generator is touched."""
    mu, seeds = draw_worlds(application, 8, seed=2)
    first = application.evaluate(mu, seeds)
    np.random.random()  # noqa: NPY002 - the legacy global generator is what is watched here
    random.random()
    before = global_states()
    second = application.evaluate(mu, seeds)
    _require(
        data_equivalence(first.infos, second.infos, exact=True),
        "Expected the same outcomes for the same seeds, got others the second time. Draw all "
        "randomness from numpy.random.default_rng(seed), and put no time into info.",
    )
    _require(
        before == global_states(),
        "Expected the global generators of numpy, random and torch to be left alone, but evaluate "
        "moved one. Use numpy.random.default_rng(seed).",
    )
    other = application.evaluate(mu, [(seed + 1) % 2**31 for seed in seeds])
    matters = (other.score != first.score).any()
    return f"Fixed by the seed; the seed {'matters' if matters else 'changes no score'}."


def check_bad_input(application: Application) -> str:
    """Check that bad mu and seeds are refused."""
    dimension = len(application.parameters)
    good = np.zeros((1, dimension), dtype=np.float32)
    for what, mu, seeds in (
        ("NaN", good * np.nan, [0]),
        ("mu outside the box", good + 1.5, [0]),
        ("mu of another dimension", np.zeros((1, dimension + 1)), [0]),
        ("a negative seed", good, [-1]),
        ("two seeds for one mu", good, [0, 1]),
    ):
        try:
            application.evaluate(mu, seeds)
        except ValueError:
            continue
        raise AssertionError(
            f"Expected a ValueError for {what}, got none. Do not override `evaluate`."
        )
    return "Bad mu and seeds are refused."


def check_live_parameters(application: Application, *, seed: int = 0) -> str:
    """Check that every parameter changes the score somewhere, while the seeds stay the same.

    `seed` fixes the pairs of worlds. One whose first pairs show every parameter is fastest.
    """
    dimension = len(application.parameters)
    dead = set(range(dimension))
    pairs = 0
    for attempt, n in enumerate([2, 2, 4] + 15 * [8]):  # most parameters show with the first
        draw = 1_000 * seed + attempt
        mu, seeds = draw_worlds(application, n, seed=100 + draw)
        others, _ = draw_worlds(application, n, seed=200 + draw)
        axes = sorted(dead)
        moved = np.repeat(mu[None], len(axes), axis=0)
        for row, axis in enumerate(axes):
            moved[row, :, axis] = others[:, axis]
        # in one batch, which is faster than one an axis
        batch = np.concatenate([mu[None], moved]).reshape(-1, dimension)
        score = application.evaluate(batch, (1 + len(axes)) * seeds).score.reshape(-1, n)
        changed = (score[1:] != score[0]).any(axis=1)
        dead -= {axis for axis, alive in zip(axes, changed, strict=True) if alive}
        pairs += n
        if not dead:
            return "Every parameter changes the score."
    names = [application.parameters.names[axis] for axis in sorted(dead)]
    raise AssertionError(
        f"Expected every parameter to change the score, got no change by {', '.join(names)} over "
        f"{pairs} pairs of worlds. Give it something to act on, or leave it out."
    )


def check_purity(application: Application) -> str:
    """Check that a score doesn't depend on what else is evaluated.

    Batches around `application.tile` are tried too, and the finding names the tile.
    """
    tile = getattr(application, "tile", None)
    if not isinstance(tile, int) or isinstance(tile, bool) or not 1 <= tile <= MAX_TILE:
        tile = None
    sizes = SIZES if tile is None else tuple(sorted({*SIZES, tile, tile + 1}))
    try:
        assert_pure(application, n=_WORLDS, sizes=sizes, alone=_ALONE, other_process=False)
    except AssertionError as error:
        if tile is None:
            raise
        hint = "an input's neighbours are not the cause" if tile == 1 else "try tile=1"
        raise AssertionError(
            f"{error} The agent is called with {tile} input{'s' * (tile > 1)} at once "
            f"(tile={tile}): {hint}."
        ) from error
    how = "permuted" if tile is None else f"permuted, with tile={tile}"
    return f"The same to the last bit alone, in batches of {min(sizes)} to {max(sizes)}, {how}."


def check_other_process(application: Application) -> str:
    """Check that a pickled copy gives the same outcomes in another process."""
    assert_same_in_another_process(application, n=_WORLDS)
    return "The same to the last bit in another process."


def check_pictures(application: Application) -> str:
    """Check that pictures, if there are any, are RGB images and the same each time."""
    if not application.can_render:
        return "It draws none, which is allowed."
    mu = np.zeros(len(application.parameters), dtype=np.float32)
    draws = [application.render]
    if type(application).observation is not Application.observation:
        draws.append(application.observation)
    for draw in draws:
        frame = draw(mu, 0)
        _require(
            isinstance(frame, np.ndarray)
            and frame.dtype == np.uint8
            and frame.ndim == 3
            and frame.shape[2] == 3,
            f"Expected `{draw.__name__}` to give an array of shape (height, width, 3) and dtype "
            f"uint8, got {type(frame).__name__} of shape {np.shape(frame)} and dtype "
            f"{getattr(frame, 'dtype', None)}.",
        )
        _require(
            np.array_equal(frame, draw(mu, 0)),
            f"Expected the same picture of the same world by `{draw.__name__}`, got another the "
            "second time.",
        )
    return f"{frame.shape[1]} x {frame.shape[0]} pixels."


def check_environment_steps(env: AdversaryEnv) -> str:
    """Check that the reward is -score, and that reset and step equal `evaluate`."""
    (mu,), (seed,) = draw_worlds(env.application, 1, seed=3)
    env.reset(seed=seed)
    _, reward, terminated, truncated, info = env.step(mu)
    expected = env.application.evaluate(mu[None], [seed]).infos[0]
    _require(
        reward == -info["score"] and data_equivalence(info, expected, exact=True),
        f"Expected reset(seed={seed}) and step(mu) to equal evaluate([mu], [{seed}]), got "
        f"{info} with reward {reward} instead of {expected}.",
    )
    _require(
        terminated is (env.horizon == 1) and truncated is False,
        f"Expected an episode of {env.horizon} steps, got terminated={terminated} and "
        f"truncated={truncated} after the first.",
    )
    return "The reward is exactly -score; reset and step equal evaluate."


def _shape_of(value: Any) -> Any:
    """Reduce an info to what must be the same in every world: keys, types and array shapes."""
    if isinstance(value, Mapping):
        return {key: _shape_of(value[key]) for key in sorted(value)}
    if isinstance(value, np.ndarray):
        return (value.dtype.name, value.shape)
    return type(value).__name__


def _is_finite(value: Any) -> bool:
    if isinstance(value, Mapping):
        return all(map(_is_finite, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_is_finite, value))
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return bool(np.isfinite(value).all())
    return not isinstance(value, float | np.floating) or math.isfinite(value)


def global_states() -> bytes:
    """Pickle the states of the global generators of numpy, random and, where loaded, torch."""
    torch = sys.modules.get("torch")
    states = [np.random.get_state(), random.getstate()]  # noqa: NPY002
    return pickle.dumps([*states, torch.get_rng_state().numpy() if torch else None])
