"""Searches for failures of the parking agent: INDAGO's and INDAGO-Nexus', rebuilt from the papers.

Both learn a classifier from the worlds of the agent's training and from whether it failed in them,
and only propose worlds for which the classifier expects a failure. INDAGO (Biagiola and Tonella
2023) finds each by a genetic algorithm that starts from logged failures and mutates what the
classifier's gradient points at; INDAGO-Nexus (Bartlett et al. 2025) by NSGA-II, which weighs the
expected failure against the distance to all that was proposed before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from sada_gym.foundations.determinism import generators_kept
from studies.training.parking.world import HALF_X_M, HALF_Y_M, SLOTS

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ask = Callable[[Floats], Bools]
"""Plays worlds, features (n, 24), and says in which the agent failed, (n,)."""

GOAL, HEADING, X, Y = range(SLOTS, SLOTS + 4)
WIDTH = SLOTS + 4
LOW = np.array([0.0] * SLOTS + [0.0, 0.0, -HALF_X_M, -HALF_Y_M])
HIGH = np.array([1.0] * SLOTS + [SLOTS - 1.0, 1.0, HALF_X_M, HALF_Y_M])

POPULATION, GENERATIONS, ELITE, CROSSOVER_RATE = 50, 20, 3, 0.75
FRONT_TAKEN = 5
"""How many worlds of each of Nexus' fronts are played."""
_UNTRAINED = 0.2
"""The share of the log, from its beginning, that is left out: the agent had learnt nothing yet."""
_EPOCHS, _PATIENCE, _BATCH, _VALIDATION = 300, 10, 128, 0.2


@dataclass(frozen=True)
class TrainingLog:
    """The worlds of an agent's training, features (n, 24), and in which it failed, (n,)."""

    features: Floats
    failed: Bools

    def later(self) -> TrainingLog:
        """Return what came after the agent's first steps."""
        first = int(_UNTRAINED * len(self.failed))
        return TrainingLog(self.features[first:], self.failed[first:])


class Classifier:
    """Says how probable a failure is; INDAGO's network of two hidden layers.

    Args:
        log: What it learns from. A fifth is held out and ends the training.
        seed: Fixes weights, batches and what is held out.
    """

    def __init__(self, log: TrainingLog, seed: int) -> None:
        with generators_kept():
            torch.manual_seed(seed)
            self._network = nn.Sequential(
                *(nn.Linear(WIDTH, 32), nn.BatchNorm1d(32), nn.ReLU(), nn.Dropout(0.5)),
                *(nn.Linear(32, 32), nn.BatchNorm1d(32), nn.ReLU(), nn.Dropout(0.5)),
                nn.Linear(32, 2),
            )
            self.fit(log)

    def fit(self, log: TrainingLog) -> None:
        rows = torch.randperm(len(log.failed))
        held, kept = rows.split(
            [int(_VALIDATION * len(rows)), len(rows) - int(_VALIDATION * len(rows))]
        )
        inputs = torch.tensor(log.features, dtype=torch.float32)
        targets = torch.tensor(log.failed, dtype=torch.int64)
        counts = torch.bincount(targets[kept], minlength=2).clamp(min=1)
        loss = nn.CrossEntropyLoss(weight=len(kept) / (2.0 * counts))
        optimiser = torch.optim.Adam(self._network.parameters(), lr=1e-3)
        best, best_loss, waited = self._network.state_dict(), float("inf"), 0
        for _ in range(_EPOCHS):
            self._network.train()
            for batch in kept[torch.randperm(len(kept))].split(_BATCH):
                if len(batch) > 1:  # batch normalisation needs two
                    optimiser.zero_grad()
                    loss(self._network(inputs[batch]), targets[batch]).backward()
                    optimiser.step()
            self._network.eval()
            with torch.no_grad():
                held_loss = float(loss(self._network(inputs[held]), targets[held]))
            if held_loss < best_loss:
                best_loss, waited = held_loss, 0
                best = {key: value.clone() for key, value in self._network.state_dict().items()}
            elif (waited := waited + 1) >= _PATIENCE:
                break
        self._network.load_state_dict(best)
        self._network.eval()

    def __call__(self, features: Floats) -> Floats:
        """Return the probability of a failure in each world: (n,)."""
        with torch.no_grad():
            logits = self._network(torch.tensor(features, dtype=torch.float32))
        return np.asarray(logits.softmax(dim=1)[:, 1], np.float64)

    def gradient(self, features: Floats) -> Floats:
        """Return the gradient of the failure's logit with respect to the features: (n, 24)."""
        inputs = torch.tensor(features, dtype=torch.float32, requires_grad=True)
        (gradient,) = torch.autograd.grad(self._network(inputs)[:, 1].sum(), inputs)
        return np.asarray(gradient, np.float64)


def valid(features: Floats) -> Bools:
    """Say which worlds lie in their ranges and have no car in the goal: (n,)."""
    inside = ((features >= LOW) & (features <= HIGH)).all(axis=1)
    goal = np.clip(features[:, GOAL], 0, SLOTS - 1).astype(int)
    free: Bools = features[np.arange(len(features)), goal] < 0.5
    return inside & free


def indago(ask: Ask, budget: int, log: TrainingLog, seed: int) -> None:
    """Play `budget` worlds, each the best of a genetic algorithm of its own."""
    log = log.later()
    classifier, rng = Classifier(log, seed), np.random.default_rng([seed, 1])
    for _ in range(budget):
        population = log.features[_failures(log, rng, POPULATION)].copy()
        for _ in range(GENERATIONS):
            population = _next_generation(population, classifier, rng)
        ask(population[[int(np.argmax(classifier(population)))]])


def _failures(log: TrainingLog, rng: np.random.Generator, count: int) -> npt.NDArray[np.intp]:
    rows = np.flatnonzero(log.failed)
    later = (rows + 1.0) / (rows + 1.0).sum()  # the later, the better the agent that failed
    return rng.choice(rows, count, replace=len(rows) < count, p=later)


def _next_generation(
    population: Floats, classifier: Classifier, rng: np.random.Generator
) -> Floats:
    fitness = classifier(population)
    order = np.argsort(-fitness)
    pairs = (len(population) - ELITE + 1) // 2
    parents = rng.choice(len(population), (pairs, 2), p=fitness / fitness.sum())
    children = np.stack([_crossed(population[pair], rng) for pair in parents])
    flat = children.reshape(-1, WIDTH)
    children = _mutated(flat, classifier.gradient(flat), rng).reshape(children.shape)
    chances = classifier(children.reshape(-1, WIDTH)).reshape(pairs, 2)
    better = chances.max(axis=1) >= fitness[parents].max(axis=1)
    kept = np.where(better[:, None, None], children, population[parents]).reshape(-1, WIDTH)
    return np.concatenate([population[order[:ELITE]], kept])[: len(population)]


def _crossed(pair: Floats, rng: np.random.Generator) -> Floats:
    """Exchange what follows one point of: goal, heading, parked cars, position."""
    if rng.random() >= CROSSOVER_RATE:
        return pair.copy()
    parts = ([GOAL], [HEADING], list(range(SLOTS)), [X, Y])
    exchanged = [column for part in parts[rng.integers(1, len(parts)) :] for column in part]
    crossed = pair.copy()
    crossed[:, exchanged] = pair[::-1, exchanged]
    possible = valid(crossed)
    return np.where(possible[:, None], crossed, pair)


def _mutated(features: Floats, gradient: Floats, rng: np.random.Generator) -> Floats:
    """Change one feature of each world, drawn by its gradient, towards more failure."""
    mutated = features.copy()
    for row, slopes in zip(mutated, gradient, strict=True):
        weights = np.abs(slopes) + 1e-12
        column = int(rng.choice(WIDTH, p=weights / weights.sum()))
        upwards = 1.0 if slopes[column] > 0.0 else -1.0
        if column < SLOTS:
            row[column] = 1.0 - row[column]
        elif column == GOAL:
            row[column] += upwards * rng.integers(1, SLOTS)
        else:
            row[column] += upwards * rng.random()
    return np.where(valid(mutated)[:, None], mutated, features)


def nexus(ask: Ask, budget: int, log: TrainingLog, seed: int) -> None:
    """Play `budget` worlds, five at a time from the knee of a front of NSGA-II."""
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.core.problem import Problem
    from pymoo.optimize import minimize

    log = log.later()
    classifier, rng = Classifier(log, seed), np.random.default_rng([seed, 2])
    archive = np.empty((0, WIDTH))

    class Front(Problem):  # type: ignore[misc]
        """Less probable success, and a greater distance to the archive's nearest world."""

        def __init__(self) -> None:
            super().__init__(n_var=WIDTH, n_obj=2, xl=LOW, xu=HIGH)

        def _evaluate(self, x: Floats, out: dict[str, Floats], *_: object, **__: object) -> None:
            worlds = repaired(x)
            out["F"] = np.column_stack([1.0 - classifier(worlds), -distances(worlds, archive)])

    while budget > 0:
        start = log.features[_failures(log, rng, POPULATION)]
        found = minimize(
            Front(),
            NSGA2(pop_size=POPULATION, sampling=start),
            ("n_gen", GENERATIONS),
            seed=int(rng.integers(2**31)),
        )
        chosen = repaired(np.atleast_2d(found.X)[knee(np.atleast_2d(found.F), FRONT_TAKEN)])
        chosen = chosen[:budget]
        ask(chosen)
        archive, budget = np.concatenate([archive, chosen]), budget - len(chosen)


def repaired(features: Floats) -> Floats:
    """Round slots and goal, and take a car out of the goal."""
    worlds = np.clip(features, LOW, HIGH)
    worlds[:, : SLOTS + 1] = np.rint(worlds[:, : SLOTS + 1])
    worlds[np.arange(len(worlds)), worlds[:, GOAL].astype(int)] = 0.0
    return worlds


def distances(features: Floats, archive: Floats) -> Floats:
    """Return each world's distance to the nearest of the archive, (n,), each feature from 0 to 1.

    Without an archive it is that to the nearest other one of the worlds themselves.
    """
    scaled = (features - LOW) / (HIGH - LOW)
    others = (archive - LOW) / (HIGH - LOW) if len(archive) else scaled
    between = np.linalg.norm(scaled[:, None] - others[None], axis=2)
    if not len(archive):
        np.fill_diagonal(between, np.inf)
    nearest = between.min(axis=1)
    return np.where(np.isfinite(nearest), nearest, 0.0)


def knee(front: Floats, count: int) -> npt.NDArray[np.intp]:
    """Return the rows of a front, (n, 2), that lie farthest below the line between its ends."""
    span = np.ptp(front, axis=0)
    scaled = (front - front.min(axis=0)) / np.where(span > 0.0, span, 1.0)
    return np.argsort(scaled.sum(axis=1), kind="stable")[:count]
