"""`svm`: a multi-class support vector machine on all of Omega (a baseline of the paper)."""

from __future__ import annotations

import math
from itertools import combinations, product
from typing import ClassVar

import numpy as np
from scipy.spatial.distance import cdist
from sklearn.svm import SVC

from sada_gym.adversaries.fitted import Arrays, validate_array
from sada_gym.adversaries.selection import Selection
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import AnyFloats, Floats, Integers

ONE_CLASS = "all scores of Omega fall into one of the five bins: samples are uniform"

_UNIT_VARIANCE = math.sqrt(3.0)  # the scale at which the uniform distribution has it
_EDGES = (0.2, 0.4, 0.6, 0.8)
_PENALTIES = (0.1, 1.0, 10.0, 100.0)
_WIDTHS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
_FOLDS = 3
_CACHE_MB = 500
_BLOCK = 1_000


class SVM(Selection):
    """A multi-class SVM of the score in five equal bins; samples are random mu of the lowest bin.

    A baseline of Hamdi, Mueller, Ghanem 2020, section "Testing, Evaluation, and Baselines", which
    names neither kernel nor penalty. Here it has an RBF kernel on standardised inputs, votes of
    pairs of classes, and balanced class weights. C and gamma have the best balanced accuracy in a
    threefold cross-validation on a subset of Omega. See `Selection` for how samples are chosen,
    and `SelectionOptions` for the options.
    """

    name: ClassVar[str] = "svm"
    packages = ("scikit-learn",)

    def fit(self, queries: Evaluations) -> None:
        x = _UNIT_VARIANCE * queries.mu.astype(np.float64)
        label = np.digitize(queries.score, _EDGES)
        self._classes = np.unique(label)
        self._gamma = 0.0
        self._vectors = np.zeros((0, self.dimension))
        self._coefficients, self._intercepts = np.zeros((0, 0)), np.zeros(0)
        if len(self._classes) == 1:
            self.flags.append(ONE_CLASS)
            return
        # rows such that every class has its share of them, and of each fold
        shuffled = self.rng.permutation(len(label))
        order = shuffled[np.argsort(label[shuffled], kind="stable")]
        count = min(self.options.subset, len(label))
        rows = order[np.linspace(0, len(label) - 1, count).astype(np.intp)]
        penalty, self._gamma = _cross_validate(x[rows], label[rows], np.arange(len(rows)) % _FOLDS)
        machine = _machine(penalty, self._gamma).fit(x, label)
        self._vectors, self._intercepts = machine.support_vectors_, machine.intercept_
        self._coefficients = _coefficients(machine)
        if len(self._classes) == 2:  # scikit-learn turns the sign of a single pair
            self._coefficients, self._intercepts = -self._coefficients, -self._intercepts

    def _predict(self, mu: Floats) -> AnyFloats:
        votes = np.zeros((len(mu), len(self._classes)))
        x = _UNIT_VARIANCE * mu
        for start in range(0, len(mu), _BLOCK):
            rows = slice(start, start + _BLOCK)
            kernel = np.exp(-self._gamma * cdist(x[rows], self._vectors, "sqeuclidean"))
            decisions = kernel @ self._coefficients + self._intercepts
            for pair, (a, b) in enumerate(combinations(range(len(self._classes)), 2)):
                votes[rows, a] += decisions[:, pair] > 0
                votes[rows, b] += decisions[:, pair] <= 0
        predicted: Floats = self._classes[votes.argmax(axis=1)].astype(np.float64)
        return predicted

    def arrays(self) -> Arrays:
        return {
            "classes": self._classes,
            "gamma": np.array(self._gamma),
            "vectors": self._vectors,
            "coefficients": self._coefficients,
            "intercepts": self._intercepts,
        }

    def restore(self, arrays: Arrays) -> None:
        self._classes = validate_array(arrays, "classes", None)
        count = len(self._classes)
        if not 1 <= count <= len(_EDGES) + 1:
            raise UserError(f"there are {count} classes, not 1 to {len(_EDGES) + 1}")
        pairs = count * (count - 1) // 2
        self._gamma = float(validate_array(arrays, "gamma"))
        self._vectors = validate_array(arrays, "vectors", None, self.dimension)
        self._coefficients = validate_array(arrays, "coefficients", len(self._vectors), pairs)
        self._intercepts = validate_array(arrays, "intercepts", pairs)


def _machine(penalty: float, gamma: float) -> SVC:
    # without a random state of its own it would draw from the global generator, for nothing
    return SVC(
        C=penalty, gamma=gamma, class_weight="balanced", cache_size=_CACHE_MB, random_state=0
    )


def _cross_validate(x: Floats, label: Integers, fold: Integers) -> tuple[float, float]:
    best, choice = -1.0, (_PENALTIES[0], _WIDTHS[0] / x.shape[1])
    for penalty, width in product(_PENALTIES, _WIDTHS):
        gamma = width / x.shape[1]
        right = np.zeros(len(label), dtype=bool)
        for k in np.unique(fold):
            train, test = fold != k, fold == k
            if len(np.unique(label[train])) > 1:
                machine = _machine(penalty, gamma).fit(x[train], label[train])
                right[test] = machine.predict(x[test]) == label[test]
        accuracy = float(np.mean([right[label == c].mean() for c in np.unique(label)]))
        if accuracy > best:
            best, choice = accuracy, (penalty, gamma)
    return choice


def _coefficients(machine: SVC) -> Floats:
    """Spread the dual coefficients to a column for each pair of classes: (vectors, pairs).

    libsvm keeps, for a vector of class a, the coefficients against every other class in order.
    """
    ends = np.cumsum(machine.n_support_)
    of_class = [
        slice(end - count, end) for end, count in zip(ends, machine.n_support_, strict=True)
    ]
    pairs = list(combinations(range(len(ends)), 2))
    columns = np.zeros((ends[-1], len(pairs)))
    for pair, (a, b) in enumerate(pairs):
        columns[of_class[a], pair] = machine.dual_coef_[b - 1, of_class[a]]
        columns[of_class[b], pair] = machine.dual_coef_[a, of_class[b]]
    return columns
