"""Other methods that name where worlds fool: PRIM, and the leaves of a decision tree."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sada_gym.foundations.arrays import Bools, Floats
from studies.planted_queries import Known
from studies.planted_settings import Setting

Named = list[Callable[[Floats], Bools]]
"""What a method names: which shares, (n, d), lie in each rule."""


def by_prim(_: Setting, known: Known, __: np.random.Generator) -> Named:
    """Name boxes by PRIM (Friedman and Fisher 1999), of each trajectory the one of the best F1.

    At least half of the worlds in a box fool. Boxes are peeled by 5 % of the worlds in them, down
    to 2 % of all, pasted by as many, and found one after another.
    """
    left, named = np.ones(len(known.fooled), np.bool_), []
    while len(named) < 5:
        box = _peel(known.shares[left], known.fooled[left])
        inside = left & _in_box(box, known.shares)
        if not inside.any() or known.fooled[inside].mean() < 0.5:
            break
        named.append(lambda shares, box=box: _in_box(box, shares))
        left &= ~inside
    return named


def _in_box(box: Floats, shares: Floats) -> Bools:
    return np.asarray(((shares >= box[0]) & (shares <= box[1])).all(axis=1))


def _peel(shares: Floats, fooled: Bools) -> Floats:
    box = np.stack([np.zeros(shares.shape[1]), np.ones(shares.shape[1])])
    total, best, best_f1 = max(int(fooled.sum()), 1), box.copy(), 0.0
    inside = np.ones(len(shares), np.bool_)
    while inside.sum() > 0.02 * len(shares):
        tried = []
        for j in range(shares.shape[1]):
            for side, quantile in ((0, 0.05), (1, 0.95)):
                smaller = box.copy()
                smaller[side, j] = np.quantile(shares[inside, j], quantile)
                kept = inside & _in_box(smaller, shares)
                if 0 < kept.sum() < inside.sum():
                    tried.append((fooled[kept].mean(), j, side, smaller, kept))
        if not tried:
            break
        *_, box, inside = max(tried, key=lambda one: one[0])
        hits = fooled[inside].sum()
        f1 = 2.0 * hits / (inside.sum() + total) if hits >= 0.5 * inside.sum() else 0.0
        if f1 > best_f1:
            best, best_f1 = box.copy(), f1
    return _paste(best, shares, fooled)


def _paste(box: Floats, shares: Floats, fooled: Bools) -> Floats:
    while True:
        inside = _in_box(box, shares)
        mean, more = fooled[inside].mean(), max(int(0.05 * inside.sum()), 1)
        best = None
        for j in range(shares.shape[1]):
            other = _in_box(np.delete(box, j, axis=1), np.delete(shares, j, axis=1)) & ~inside
            for side in (0, 1):
                beyond = shares[other, j]
                beyond = beyond[beyond < box[0, j]] if side == 0 else beyond[beyond > box[1, j]]
                if not len(beyond):
                    continue
                ordered = np.sort(beyond) if side else -np.sort(-beyond)
                larger = box.copy()
                larger[side, j] = ordered[min(more, len(ordered)) - 1]
                rate = fooled[_in_box(larger, shares)].mean()
                if rate > mean:
                    best, mean = larger, rate
        if best is None:
            return box
        box = best


def by_tree(_: Setting, known: Known, __: np.random.Generator) -> Named:
    """Name the leaves of a tree in which most worlds fool; its size by cross-validation."""
    from sklearn.model_selection import GridSearchCV
    from sklearn.tree import DecisionTreeClassifier

    search = GridSearchCV(
        DecisionTreeClassifier(min_samples_leaf=15, random_state=0),
        {"max_leaf_nodes": [2, 4, 8, 16, 32]},
        scoring="neg_log_loss",
    ).fit(known.shares, known.fooled)
    tree = search.best_estimator_
    leaf = tree.apply(known.shares)
    weak = [i for i in np.unique(leaf) if known.fooled[leaf == i].mean() >= 0.5]
    return [lambda shares, i=i: tree.apply(shares) == i for i in weak]
