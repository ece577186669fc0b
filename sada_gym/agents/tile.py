"""Tiles: a network always sees batches of one size, whatever the number of its inputs.

A batch of another size would give other last bits, and a closed loop makes another episode of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.foundations.determinism import one_thread

Batch = dict[str, npt.NDArray[Any]]
"""Inputs of n agents, each key (n, ...)."""

ALONE = "(alone)"
"""The key of observations that are no dictionaries."""

Answers = TypeVar("Answers")


def keyed(space: spaces.Space[Any]) -> spaces.Dict:
    """Return the spaces of a batch by key: a dictionary's own, or the one key of another space."""
    return space if isinstance(space, spaces.Dict) else spaces.Dict({ALONE: space})


def fits_batches(space: Any) -> bool:
    """Say whether observations are numbers, or a flat dictionary of them."""
    kinds = (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
    parts = space.values() if isinstance(space, spaces.Dict) else [space]
    return all(isinstance(part, kinds) for part in parts)


def sampled(space: spaces.Dict, count: int) -> Batch:
    """Draw observations, always the same, to try out an agent."""
    drawn = deepcopy(space)
    drawn.seed(0)
    return as_batch([drawn.sample() for _ in range(count)], drawn)


def as_batch(observations: Sequence[Any], space: spaces.Space[Any]) -> Batch:
    """Lay observations of a space behind one another, each key (n, ...)."""
    if isinstance(space, spaces.Dict):
        return {
            key: np.stack(
                [np.asarray(observation[key], part.dtype) for observation in observations]
            )
            for key, part in space.items()
        }
    return {ALONE: np.stack([np.asarray(observation, space.dtype) for observation in observations])}


def tiled(
    network: Callable[[Batch], Answers],
    batch: Mapping[str, npt.NDArray[Any]],
    size: int,
    *,
    blank: bool = False,
) -> list[Answers]:
    """Run a network on tiles of a batch, `size` rows at a time, so that answers are reproducible.

    The last tile is filled up. Torch uses one thread, as more would change the answers' last bits.

    Args:
        network: A function that takes a full tile and returns `size` answers.
        batch: The inputs, each key (n, ...).
        size: The number of rows of a tile.
        blank: Fill the last tile with zeros. Otherwise it is filled with copies of its first row.

    Returns:
        The answers to each tile, in order; the rows that fill the last tile are left out.
    """
    count = len(next(iter(batch.values())))
    answers: list[Any] = []
    with one_thread():
        for start in range(0, count, size):
            chosen = {key: value[start : start + size] for key, value in batch.items()}
            rows = min(size, count - start)
            filled = {
                key: np.concatenate([value, _filling(value, size - rows, blank)])
                for key, value in chosen.items()
            }
            tile_answers: Any = network(filled)
            answers.append(tile_answers[:rows])
    return answers


def _filling(value: npt.NDArray[Any], rows: int, blank: bool) -> npt.NDArray[Any]:
    # also where there are no rows: `concatenate` then lays a transposed picture out in the same
    # order in memory as in other tiles, and convolutions give other last bits for another order
    if blank:
        return np.zeros((rows, *value.shape[1:]), value.dtype)
    return np.repeat(value[:1], rows, axis=0)
