"""DAgger (Ross, Gordon, Bagnell 2011): a learner acts, an expert says what it would have done."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from studies.training.common import Imitation


class Examples:
    """Observations, and an expert's answers to them: arrays that are filled from the front.

    Args:
        size: Most rows that are kept.
    """

    def __init__(self, size: int) -> None:
        self._size, self._count = size, 0
        self._arrays: dict[str, npt.NDArray[Any]] = {}
        self._answers = np.empty((0, 0), np.float32)

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._count

    def add(
        self, observation: Mapping[str, npt.NDArray[Any]], answers: npt.NDArray[np.floating[Any]]
    ) -> None:
        """Add n rows; those beyond the size are dropped.

        Args:
            observation: Each key (n, ...).
            answers: (n, k), kept as float32.
        """
        if not self._arrays:
            self._answers = np.empty((self._size, *answers.shape[1:]), np.float32)
            self._arrays = {
                key: np.empty((self._size, *value.shape[1:]), value.dtype)
                for key, value in observation.items()
            }
        rows = slice(self._count, self._count + len(answers))
        room = len(self._answers[rows])
        for key, value in observation.items():
            self._arrays[key][rows] = value[:room]
        self._answers[rows] = answers[:room]
        self._count += room

    def batch(self, rows: npt.NDArray[np.intp]) -> tuple[dict[str, Tensor], Tensor]:
        """Return the observations and answers of some rows."""
        observation = {key: torch.from_numpy(value[rows]) for key, value in self._arrays.items()}
        return observation, torch.from_numpy(self._answers[rows])


def dagger(
    settings: Imitation[Any], gather: Callable[[float], str], fit: Callable[[int], float]
) -> None:
    """Alternate between gathering and fitting; the expert acts less from round to round.

    Args:
        settings: The recipe.
        gather: Takes the share of episodes in which the expert acts, adds a round's examples, and
            says how the episodes ended.
        fit: Takes a number of epochs, fits the learner to all examples, and gives the mean loss.
    """
    started = time.process_time()
    for number in range(settings.rounds):
        outcome = gather(1.0 if number == 0 else 0.5**number)
        last = number == settings.rounds - 1
        loss = fit(settings.last_epochs if last else settings.epochs)
        print(
            f"round {number}: {outcome}, loss {loss:.4f}, {time.process_time() - started:.0f} s",
            flush=True,
        )


def fit(
    parameters: Sequence[nn.Parameter],
    examples: Examples,
    settings: Imitation[Any],
    epochs: int,
    rng: np.random.Generator,
    loss: Callable[[dict[str, Tensor], Tensor], Tensor],
) -> float:
    """Fit parameters to all examples, and give the last epoch's mean loss.

    Args:
        parameters: What is fitted.
        examples: What they are fitted to.
        settings: The recipe.
        epochs: Passes over the examples.
        rng: Shuffles them.
        loss: Gives the loss of observations and the expert's answers to them.
    """
    optimiser = torch.optim.Adam(parameters, lr=settings.rate)
    steps = epochs * -(-len(examples) // settings.batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.rate, total_steps=steps)
    mean = 0.0
    for _ in range(epochs):
        losses = []
        for rows in _batches(len(examples), settings.batch, rng):
            value = loss(*examples.batch(rows))
            optimiser.zero_grad()
            value.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(parameters, 1.0)
            optimiser.step()
            schedule.step()
            losses.append(float(value.detach()))
        mean = float(np.mean(losses))
    return mean


def relight(images: Tensor, brightness: float, tint: float, rng: np.random.Generator) -> Tensor:
    """Show each image in another light.

    Args:
        images: Bytes, (n, rows, columns, 3).
        brightness: How much brightness changes at most, as a share.
        tint: How much each colour, and the black level, change at most.
        rng: Draws the changes.

    Returns:
        (n, 3, rows, columns) in [0, 1].
    """

    def draw(width: float, channels: int) -> Tensor:
        values = rng.uniform(-width, width, (len(images), channels, 1, 1))
        return torch.from_numpy(values.astype(np.float32))

    light = images.permute(0, 3, 1, 2).float() / 255
    gain = 1 + draw(brightness, 1) + draw(tint, 3)
    return (light * gain + draw(tint, 1)).clamp_(0, 1)


def _batches(count: int, size: int, rng: np.random.Generator) -> Iterator[npt.NDArray[np.intp]]:
    """Yield the indices of an epoch over `count` rows, in a new order, `size` at a time."""
    order = rng.permutation(count)
    for start in range(0, count, size):
        yield order[start : start + size]
