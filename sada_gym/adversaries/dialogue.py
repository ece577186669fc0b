"""Ask and tell: an adversary trains while the caller owns the loop over its queries."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable
from queue import Queue

import numpy as np
import numpy.typing as npt

from sada_gym.errors import BudgetExhausted, UserError
from sada_gym.foundations.arrays import Floats, real_scores
from sada_gym.parameters import Mu, Permits, validate_mu


class _Left(BaseException):
    """The caller began another training, and nobody will tell the scores of this one."""


class Dialogue:
    """A training whose queries are asked for, and whose scores are told.

    `train` runs in a thread of its own and waits there for each batch of scores. So it sees the
    same scores in the same order as with an oracle, and learns the same to the last bit.

    Args:
        train: Trains by an oracle.
        dimension: d.
        budget: The number of queries.
        threshold: The agent is fooled where Q <= this.
        permits: See `Permits`.
    """

    def __init__(
        self,
        train: Callable[[_Waiting], None],
        dimension: int,
        budget: int,
        threshold: float,
        permits: Permits,
    ) -> None:
        self._oracle = _Waiting(dimension, budget, threshold, permits)
        self._dimension = dimension
        self._take(np.zeros((0, dimension), np.float32))
        self._is_over = False
        self._thread = threading.Thread(target=self._run, args=(train,), daemon=True)
        self._thread.start()

    def _run(self, train: Callable[[_Waiting], None]) -> None:
        end: BaseException | None = None
        try:
            train(self._oracle)
        except _Left:
            return
        except BaseException as error:  # it is raised where the caller asks
            end = error
        self._oracle.asked.put(end)

    def _take(self, batch: Mu) -> None:
        self._batch, self._handed = batch, 0
        self._scores = np.zeros(len(batch))
        self._untold: dict[bytes, list[int]] = defaultdict(list)

    def ask(self, n: int) -> Mu:
        """Return up to n queries, (m, d); none where the training is over.

        What `train` raises is raised here. It is a UserError to ask on where the scores of earlier
        queries are needed first.
        """
        if not self._is_over and self._handed == len(self._batch):
            if self._untold:
                raise UserError(
                    f"Expected the scores of {sum(map(len, self._untold.values()))} queries before "
                    "more are asked for, got none. Call tell(mu, q)."
                )
            asked = self._oracle.asked.get()
            if isinstance(asked, np.ndarray):
                self._take(asked)
            else:
                self._is_over = True
                self._thread.join()
                if asked is not None:
                    raise asked
        rows = self._batch[self._handed : self._handed + n]
        for i, row in enumerate(rows, self._handed):
            self._untold[row.tobytes()].append(i)
        self._handed += len(rows)
        return rows.copy()

    def tell(self, mu: npt.ArrayLike, q: npt.ArrayLike) -> None:
        """Take the scores q, (m,), of queries mu, (m, d), that were asked: in any order or number.

        Raises:
            UserError: If a query was not asked for, or a score is no finite number.
        """
        told, scores = validate_mu(mu, self._dimension), real_scores(q, "tell")
        if scores.shape != (len(told),) or not np.isfinite(scores).all():
            raise UserError(
                f"Expected {len(told)} finite scores, got an array of shape {scores.shape} with "
                f"{int((~np.isfinite(scores)).sum())} NaN or infinite. Tell one score per query."
            )
        for row, score in zip(told, scores.tolist(), strict=True):
            places = self._untold.get(row.tobytes())
            if not places:
                raise UserError(
                    f"Expected mu as ask returned it, got {row.tolist()}, which was not asked for "
                    "or whose score is known. Tell each query once."
                )
            self._scores[places.pop(0)] = score
            if not places:
                del self._untold[row.tobytes()]
        if len(self._batch) and self._handed == len(self._batch) and not self._untold:
            scores = self._scores
            self._take(self._batch[:0])
            self._oracle.told.put(scores)

    def leave(self) -> None:
        """End the training where it is."""
        if not self._is_over:
            self._oracle.told.put(None)


class _Waiting:
    """The oracle that `train` gets: its queries wait until they are told."""

    def __init__(self, dimension: int, budget: int, threshold: float, permits: Permits) -> None:
        self.dimension, self.remaining, self.threshold = dimension, budget, threshold
        self.permits = permits
        self.asked: Queue[Mu | BaseException | None] = Queue()
        self.told: Queue[Floats | None] = Queue()

    def __call__(self, mu: npt.ArrayLike) -> Floats:
        """Wait for the scores of mu, (n, d)."""
        batch = validate_mu(mu, self.dimension)
        if len(batch) > self.remaining:
            raise BudgetExhausted(
                f"Expected at most {self.remaining} more queries, got {len(batch)}. Ask for at "
                "most oracle.remaining, or raise the budget."
            )
        if not len(batch):
            return np.zeros(0)
        self.asked.put(batch)
        scores = self.told.get()
        if scores is None:
            raise _Left
        self.remaining -= len(batch)
        return scores
