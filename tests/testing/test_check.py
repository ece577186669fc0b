"""`sada-gym check`: sound applications pass, and each fault is named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from sada_gym.application import Application, Scored
from sada_gym.envs.detection import DetectionApplication
from sada_gym.parameters import Mu, Parameter, ParameterSpace
from sada_gym.testing.check import (
    check_application,
    check_environment,
    check_file,
    load_applications,
)
from sada_gym.testing.rules import check_purity

OWN_FILE = """
import numpy as np
from sada_gym import Application, Parameter, ParameterSpace, Scored
from helper import SCALE


class Base(Application):
    fooling_threshold = 0.3
    sample_size = 20

    def evaluate_batch(self, mu, seeds):
        score = np.abs(mu.astype(np.float64)).mean(axis=1) * SCALE
        return Scored(score, [{} for _ in seeds])


class Mine(Base):
    name = "Mine"
    parameters = ParameterSpace(Parameter("a", 0, 1), Parameter("b", 0, 1))


class Sized(Base):
    name = "Sized"

    def __init__(self, size):
        self.parameters = ParameterSpace(*(Parameter(f"x{i}", 0, 1) for i in range(size)))


SIZED = Sized(3)
"""


class Plain(Application):
    """Sound as it stands; the tests break it."""

    name = "Plain"
    fooling_threshold = 0.3
    sample_size = 10
    parameters = ParameterSpace(Parameter("a", 0, 1), Parameter("b", 0, 1))

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        score = np.abs(mu.astype(np.float64)).mean(axis=1)
        return Scored(score, [{} for _ in seeds])


class Dead(Plain):
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        return super().evaluate_batch(mu[:, :1], seeds)


class TooHigh(Plain):
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        return Scored(super().evaluate_batch(mu, seeds).score + 1, [{} for _ in seeds])


class Careless(Plain):
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        noise = 0.1 * np.random.rand(len(mu))  # noqa: NPY002 - the fault under test
        return Scored(super().evaluate_batch(mu, seeds).score * 0.5 + noise, [{} for _ in seeds])


class Meddling(Plain):
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        np.random.seed(0)  # noqa: NPY002 - the fault under test
        return super().evaluate_batch(mu, seeds)


class Averaging(Plain):
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        score = super().evaluate_batch(mu, seeds).score
        return Scored(0.9 * score + 0.1 * score.mean(), [{} for _ in seeds])


class Tiled(Plain):
    """An agent that is called with a tile of inputs, and takes its neighbours into account."""

    tile = 8

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        score = super().evaluate_batch(mu, seeds).score
        for start in range(0, len(score), self.tile):
            tile = slice(start, start + self.tile)
            score[tile] = 0.9 * score[tile] + 0.1 * score[tile].max()
        return Scored(score, [{} for _ in seeds])


class Counting(Plain):
    """Sees one input at a time, and changes with each."""

    tile = 1
    calls = 0

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        self.calls += 1
        return Scored(super().evaluate_batch(mu, seeds).score / self.calls, [{} for _ in seeds])


class Moody(Plain):
    """Gives an extra only sometimes."""

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        extras = [{"hit": True} if seed % 2 else {} for seed in seeds]
        return Scored(super().evaluate_batch(mu, seeds).score, extras)


class NotANumber(Plain):
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        return Scored(
            super().evaluate_batch(mu, seeds).score, [{"speed": float("nan")} for _ in seeds]
        )


class Unpicklable(Plain):
    def __init__(self) -> None:
        self.hook: Callable[[], None] = lambda: None


class Undeclared(Plain):
    parameters = None  # type: ignore[assignment]


class Unsettled(Plain):
    fooling_threshold = 3.0


class Smudged(Plain):
    def render(self, mu: Mu, seed: int) -> Any:
        return np.zeros((4, 4), dtype=np.uint8)


class Crashing(Plain):
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        raise KeyError("wheel")


def test_a_sound_application_passes_every_check() -> None:
    report = check_application(Plain())
    assert report.subject == "Plain"
    assert [check.name for check in report.checks if not check.passed] == []
    assert report.passed
    assert len(report.checks) == 12
    assert all(check.sentence for check in report.checks)


@pytest.mark.parametrize(
    ("application", "name", "sentence"),
    [
        (Dead, "live parameters", "got no change by b over 128 pairs of worlds"),
        (TooHigh, "scores and infos", "Expected 32 scores in [0, 1] from TooHigh.evaluate_batch"),
        (Careless, "randomness", "Draw all randomness from numpy.random.default_rng(seed)"),
        (Meddling, "randomness", "evaluate moved one. Use numpy.random.default_rng(seed)"),
        (Averaging, "purity", "Expected the same score whatever surrounds an evaluation"),
        (Moody, "scores and infos", "Give each key in every world"),
        (NotANumber, "scores and infos", "Expected no NaN and no infinity in info"),
        (Unpicklable, "another process", "Expected Unpicklable to be picklable"),
        (Undeclared, "declaration", "Expected `parameters` to be a ParameterSpace, got None"),
        (Unsettled, "declaration", "Expected `fooling_threshold` in [0, 1], got 3.0"),
        (Smudged, "pictures", "got ndarray of shape (4, 4) and dtype uint8"),
        (Crashing, "environment", "KeyError: 'wheel'"),
    ],
)
def test_each_fault_is_named(application: type[Application], name: str, sentence: str) -> None:
    report = check_application(application())
    assert not report.passed
    failed = {check.name: check.sentence for check in report.checks if not check.passed}
    assert sentence in failed[name]


def test_a_registered_id_is_checked_with_its_keywords() -> None:
    (report,) = check_environment("SADA-Analytic-v0", dimension=3)
    assert report.subject == "SADA-Analytic-v0"
    assert report.passed
    assert report.checks[0].sentence == "3 parameters: x0, x1, x2."


@pytest.mark.parametrize(
    ("application", "sentence"),
    [
        (Tiled, r"called with 8 inputs at once \(tile=8\): try tile=1\."),
        (Counting, r"called with 1 input at once \(tile=1\): an input's neighbours are not"),
    ],
)
def test_the_tile_is_named_where_purity_fails(
    application: type[Application], sentence: str
) -> None:
    with pytest.raises(AssertionError, match=sentence):
        check_purity(application())


def test_purity_is_checked_in_the_tile_in_force() -> None:
    """The sizes around a tile's are tried, whatever the tile is."""
    sizes = set()

    class Large(Plain):
        tile = 90

        def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
            sizes.add(len(mu))
            return super().evaluate_batch(mu, seeds)

    assert check_purity(Large()).endswith("in batches of 2 to 91, permuted, with tile=90.")
    assert {64, 90, 91} <= sizes
    Large.tile = 10**9  # no size: another thing of the user's
    assert check_purity(Large()).endswith("in batches of 2 to 64, permuted.")


class NeighbourlyDetector(torch.nn.Module):
    """Its confidence depends on the other images of a call."""

    def forward(self, images: list[torch.Tensor]) -> list[dict[str, torch.Tensor]]:
        score = torch.stack([image.mean() for image in images])
        score = (0.5 + score - score.mean()).clamp(0, 1)
        box, label = torch.tensor([[0.0, 0.0, 9.0, 9.0]]), torch.tensor([1])
        return [{"boxes": box, "labels": label, "scores": value[None]} for value in score]


@pytest.mark.parametrize("tile", [1, 4])
def test_a_detectors_tile_is_named_where_purity_fails(tile: int) -> None:
    application = DetectionApplication(
        "car", agent=NeighbourlyDetector().eval(), labels={"car": 1}, image_size=32, tile=tile
    )
    if tile == 1:
        assert check_purity(application).endswith("permuted, with tile=1.")
    else:
        with pytest.raises(AssertionError, match=r"with 4 inputs at once \(tile=4\): try tile=1"):
            check_purity(application)


def test_an_unknown_id_is_refused() -> None:
    with pytest.raises(ValueError, match="Did you mean 'SADA-Analytic-v0'"):
        check_environment("SADA-Analytik-v0")


def test_a_file_gives_its_instances_and_classes(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text("SCALE = 0.9\n")
    file = tmp_path / "own.py"
    file.write_text(OWN_FILE)
    assert [type(a).__name__ for a in load_applications(file)] == ["Sized", "Mine"]
    reports = check_file(file)
    assert [report.subject for report in reports] == ["Sized", "Mine"]
    for report in reports:
        assert [check.sentence for check in report.checks if not check.passed] == []


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "x = 1\n",
            r"Expected a subclass of sada_gym.Application with a `name` in '.*own.py', found",
        ),
        ("x = = 1\n", r"Expected '.*own.py' to run when imported, got SyntaxError"),
        ("import no_such_module\n", "to run when imported, got ModuleNotFoundError"),
        (
            OWN_FILE.replace("SIZED = Sized(3)\n", "").replace("from helper import SCALE", ""),
            "Expected Sized in .* to be made without arguments, got TypeError: .* Add an instance",
        ),
    ],
)
def test_a_bad_file_is_refused(tmp_path: Path, content: str, message: str) -> None:
    file = tmp_path / "own.py"
    file.write_text(content)
    with pytest.raises(ValueError, match=message):
        load_applications(file)


@pytest.mark.parametrize("name", ["missing.py", "notes.txt"])
def test_what_is_no_python_file_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(ValueError, match=r"Expected an existing Python file \(\*.py\), got '.*"):
        load_applications(tmp_path / name)


def test_each_check_is_announced_with_what_was_found_before() -> None:
    told: list[tuple[str, int]] = []
    report = check_environment(
        "SADA-Analytic-v0", on_check=lambda *now: told.append((now[0], len(now[1])))
    )
    assert told == [(check.name, i) for i, check in enumerate(report[0].checks)]
