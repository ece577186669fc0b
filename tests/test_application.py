"""Application.evaluate: what it computes around `_evaluate`, and what it refuses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sada_gym.application import Application, Scored
from sada_gym.parameters import Mu, Parameter, ParameterSpace


class Given(Application):
    """Gives the scores and extras that it was made with."""

    name = "Given"
    fooling_threshold = 0.3
    sample_size = 10
    parameters = ParameterSpace(Parameter("a", 0, 10))

    def __init__(self, score: Any, extras: Sequence[dict[str, Any]] | None = None) -> None:
        self.score = np.asarray(score)
        self.extras = [{}] * len(self.score) if extras is None else extras

    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        return Scored(self.score, self.extras)


def test_fooled_is_at_or_below_the_threshold() -> None:
    outcomes = Given([0.29, 0.3, 0.31]).evaluate([[0], [0], [0]], [1, 2, 3])
    assert_array_equal(outcomes.fooled, [True, True, False])
    assert outcomes.fooled.dtype == np.bool_
    assert outcomes.score.dtype == np.float64


def test_info_names_score_seed_and_physical_values() -> None:
    outcomes = Given([0.5], [{"shape": "van"}]).evaluate([[0.5]], [np.int64(7)])
    (info,) = outcomes.infos
    assert info == {
        "score": 0.5,
        "fooled": False,
        "seed": 7,
        "parameters": {"a": 7.5},
        "shape": "van",
    }
    assert type(info["seed"]) is int
    assert type(info["fooled"]) is bool
    assert type(info["score"]) is float


def test_an_empty_batch_never_reaches_the_world() -> None:
    outcomes = Given([0.5]).evaluate(np.zeros((0, 1)), [])
    assert outcomes.score.shape == (0,)
    assert outcomes.infos == ()


@pytest.mark.parametrize(
    ("seeds", "message"),
    [
        ([], "Expected 1 seeds, one for each mu, got 0"),
        ([0, 1], "Expected 1 seeds, one for each mu, got 2"),
        ([-1], r"Expected seeds to be ints in \[0, 2\*\*31\), got -1. Draw them with"),
        ([2**31], r"Expected seeds to be ints in \[0, 2\*\*31\), got 2147483648"),
        ([1.0], "got 1.0"),
        ([True], "got True"),
    ],
)
def test_bad_seeds_are_refused(seeds: Sequence[Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Given([0.5]).evaluate([[0]], seeds)


@pytest.mark.parametrize("score", [[np.nan], [np.inf], [1.5], [-0.1], [0.1, 0.2], [[0.1]]])
def test_bad_scores_are_the_applications_fault(score: Any) -> None:
    with pytest.raises(ValueError, match=r"Expected 1 scores in \[0, 1\] from Given._evaluate"):
        Given(score, [{}]).evaluate([[0]], [0])


def test_missing_extras_are_named() -> None:
    with pytest.raises(ValueError, match=r"Expected 1 extras from Given._evaluate.*got 0"):
        Given([0.5], []).evaluate([[0]], [0])


def test_extras_cannot_set_what_evaluate_sets() -> None:
    with pytest.raises(ValueError, match=r"leave \['fooled', 'score'\] to Application.evaluate"):
        Given([0.5], [{"score": 1.0, "fooled": True}]).evaluate([[0]], [0])


def test_an_application_without_pictures_says_so() -> None:
    with pytest.raises(NotImplementedError, match=r"Given draws no pictures. Implement `render"):
        Given([0.5]).render(np.zeros(1), 0)


def test_replay_of_a_single_frame_episode_is_its_picture_and_score() -> None:
    class Drawn(Given):
        def render(self, mu: Any, seed: int) -> Any:
            return np.full((2, 2, 3), seed, dtype=np.uint8)

    frames, score = Drawn([0.5]).replay(np.zeros(1), 7)
    assert score == 0.5
    assert_array_equal(frames, np.full((1, 2, 2, 3), 7))
