"""Application.evaluate: what it computes around `evaluate_batch`, and what it refuses."""

from __future__ import annotations

import pickle
import random
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import torch
from numpy.testing import assert_array_equal

from sada_gym.application import Application, Scored
from sada_gym.envs.adversary import AdversaryEnv, AdversaryVectorEnv
from sada_gym.envs.digits import DigitsApplication
from sada_gym.errors import UserError
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.oracle import Oracle
from sada_gym.parameters import Mu, Parameter, ParameterSpace
from sada_gym.testing.rules import global_states


class Given(Application):
    """Gives the scores and extras that it was made with."""

    name = "Given"
    fooling_threshold = 0.3
    sample_size = 10
    parameters = ParameterSpace(Parameter("a", 0, 10))

    def __init__(self, score: Any, extras: Sequence[dict[str, Any]] | None = None) -> None:
        self.score = np.asarray(score)
        self.extras = [{}] * len(self.score) if extras is None else extras

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
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
    with pytest.raises(
        ValueError, match=r"Expected 1 scores in \[0, 1\] from Given.evaluate_batch"
    ):
        Given(score, [{}]).evaluate([[0]], [0])


@pytest.mark.parametrize(
    ("score", "dtype"), [(["0.5"], "<U3"), ([0.5 + 0j], "complex128"), ([None], "object")]
)
def test_scores_that_are_no_real_numbers_are_the_applications_fault(score: Any, dtype: str) -> None:
    message = f"Expected scores from Given.evaluate_batch to be real numbers, got dtype {dtype}"
    with pytest.raises(ValueError, match=message):
        Given(score).evaluate([[0]], [0])


def test_masked_scores_are_the_applications_fault() -> None:
    class Masked(Given):
        def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
            return Scored(np.ma.masked_array([0.5], [True]), [{}])

    with pytest.raises(ValueError, match="Expected scores without a mask"):
        Masked([0.5]).evaluate([[0]], [0])


def test_scores_that_are_booleans_count_as_0_and_1() -> None:
    assert Given([True, False]).evaluate([[0], [0]], [0, 1]).score.tolist() == [1.0, 0.0]


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (
            np.zeros(1),
            r"Expected a Scored from Odd.evaluate_batch, got array\(\[0.\]\). Return one.",
        ),
        (
            Scored(np.zeros(1), None),
            "Expected 1 extras from Odd.evaluate_batch, one for each mu, got N",
        ),  # type: ignore[arg-type]
        (
            Scored(np.zeros(1), [3]),
            "Expected dictionaries as extras from Odd.evaluate_batch, got 3",
        ),  # type: ignore[list-item]
    ],
)
def test_anything_but_scores_and_dictionaries_is_the_applications_fault(
    answer: Any, message: str
) -> None:
    class Odd(Given):
        def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
            return answer

    with pytest.raises(ValueError, match=message):
        Odd([0.5]).evaluate([[0]], [0])


@pytest.mark.parametrize("seeds", [5, None, np.array(5), {5}, {5: 5}])
def test_seeds_that_are_no_list_are_refused(seeds: Any) -> None:
    with pytest.raises(ValueError, match="Expected a list of seeds, one for each mu, got"):
        Given([0.5]).evaluate([[0]], seeds)


def test_missing_extras_are_named() -> None:
    with pytest.raises(ValueError, match=r"Expected 1 extras from Given.evaluate_batch.*got 0"):
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


class Classifies(torch.nn.Module):
    """A user's classifier of digits; `change` is what is wrong with it."""

    def __init__(self, change: Any = None) -> None:
        super().__init__()
        self.layer = torch.nn.Linear(64, 10)
        torch.nn.init.constant_(self.layer.weight, 0.01)
        self.change = change
        self.calls = 0
        self.eval()

    def forward(self, images: Any) -> Any:
        self.calls += 1
        logits = self.layer(images.flatten(1))
        return logits if self.change is None else self.change(self, logits)


def sampling(classifier: Classifies, logits: Any) -> Any:
    return logits + torch.rand_like(logits)


def remembering(classifier: Classifies, logits: Any) -> Any:
    return logits * (1 + classifier.calls / 1000)


def dropping_out(classifier: Classifies, logits: Any) -> Any:
    return torch.nn.functional.dropout(logits, training=True)


def drawing_from_numpy(classifier: Classifies, logits: Any) -> Any:
    return logits * float(np.random.rand())  # noqa: NPY002 - the fault under test


def reseeding(classifier: Classifies, logits: Any) -> Any:
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002 - the fault under test
    torch.manual_seed(1)
    return logits + torch.rand_like(logits)


def of(change: Any) -> DigitsApplication:
    return DigitsApplication(image=3, agent=Classifies(change), agent_id="mine")


@pytest.mark.parametrize("change", [sampling, remembering, dropping_out, drawing_from_numpy])
def test_an_agent_that_is_random_is_refused_before_a_score_counts(
    change: Any, tmp_path: Any
) -> None:
    path = tmp_path / "run.sqlite"
    with Oracle(of(change), budget=4, store=path) as oracle:
        with pytest.raises(ValueError, match=r"answers the same whenever it is asked, but mine ga"):
            oracle(np.zeros((2, 6)))
        assert oracle.remaining == 4
    with EvaluationStore(path) as store:
        assert len(store) == 0


def test_the_sentence_on_a_random_agent_says_how_to_fix_it() -> None:
    with pytest.raises(
        ValueError, match=r"mine gave the score 0\.\d+ and then 0\.\d+ in the same "
    ):
        of(sampling).evaluate(np.zeros((1, 6)), [5])
    with pytest.raises(ValueError, match=r"deterministic=True; dropout: model\.eval\(\)"):
        of(sampling).evaluate(np.zeros((1, 6)), [5])


def test_a_users_agent_is_asked_twice_once() -> None:
    application = of(None)
    calls = application.agent.calls
    application.evaluate(np.zeros((9, 6)), range(9))
    assert application.agent.calls == calls + 4 + 4 + 9
    copy = pickle.loads(pickle.dumps(application))
    for again in (application, copy):
        calls = again.agent.calls
        again.evaluate(np.zeros((9, 6)), range(9))
        assert again.agent.calls == calls + 9


def test_a_shipped_agent_is_not_asked_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    application = DigitsApplication()
    batches = []
    monkeypatch.setattr(
        application.agent, "forward", lambda images: batches.append(1) or images.new_zeros(16, 10)
    )
    application.evaluate(np.zeros((9, 6)), range(9))
    assert len(batches) == 1


def test_an_agent_that_differs_only_in_an_extra_is_refused() -> None:
    class Drawing(Given):
        agent = object()

        def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
            return Scored(self.score, [{"path": [np.random.default_rng().random(3)]}])

    with pytest.raises(ValueError, match="but object gave the path"):
        Drawing([0.5]).evaluate([[0]], [0])


def test_extras_that_are_nan_or_unknown_objects_say_nothing_about_the_agent() -> None:
    class Odd(Given):
        agent = object()

        def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
            extra = {"a": float("nan"), "b": np.array([np.nan]), "c": object(), "d": None}
            return Scored(self.score, [extra])

    assert Odd([0.5]).evaluate([[0]], [0]).score == [0.5]


def test_an_agent_that_seeds_global_generators_leaves_the_callers_as_they_were() -> None:
    application = of(reseeding)  # pure: it seeds them anew before each answer
    before = global_states()
    first = application.evaluate(np.zeros((2, 6)), [0, 1])
    assert global_states() == before
    random.random()
    torch.rand(3)
    assert_array_equal(application.evaluate(np.zeros((2, 6)), [0, 1]).score, first.score)


def test_pictures_leave_the_callers_generators_as_they_were() -> None:
    env = AdversaryEnv(of(reseeding), render_mode="rgb_array")
    envs = AdversaryVectorEnv(of(reseeding), num_envs=2, render_mode="rgb_array")
    before = global_states()
    for each in (env, envs):
        each.reset(seed=0)
        each.step(np.zeros(each.action_space.shape))
        each.render()
        each.replay(np.zeros(6), 0)
        assert global_states() == before


def test_an_agent_that_fails_leaves_global_generators_as_they_were() -> None:
    def failing(classifier: Classifies, logits: Any) -> Any:
        torch.manual_seed(classifier.calls)
        if classifier.calls > made:
            raise KeyError
        return logits

    made = 10**6
    application = of(failing)
    made = application.agent.calls
    before = global_states()
    with pytest.raises(UserError, match="got KeyError"):
        application.evaluate(np.zeros((1, 6)), [0])
    assert global_states() == before


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("parameters", None),
        ("fooling_threshold", float("nan")),
        ("fooling_threshold", "0.3"),
        ("fooling_threshold", None),
    ],
)
def test_an_application_without_parameters_or_a_threshold_is_refused(name: str, value: Any) -> None:
    application = Given([0.5])
    setattr(application, name, value)
    message = f"Expected `{name}` of Given to be a .*, got {value!r}"
    with pytest.raises(ValueError, match=message):
        Oracle(application, budget=1)
    with pytest.raises(ValueError, match=message):
        AdversaryEnv(application)


@pytest.mark.parametrize(
    ("name", "value"), [("name", None), ("version", "1"), ("version", 2**70), ("fingerprint", 5)]
)
def test_a_store_refuses_what_it_cannot_keep(name: str, value: Any, tmp_path: Any) -> None:
    application = type("Odd", (Given,), {name: value})([0.5])
    with pytest.raises(TypeError, match=f"Expected .*{name}.*, got .*{value!r}"):
        Oracle(application, budget=1, store=tmp_path / "run.sqlite")
