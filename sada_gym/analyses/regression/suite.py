"""A regression suite: the versioned JSON file of worlds in which an agent failed and passed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator
from typing_extensions import Self

from sada_gym.errors import FileError
from sada_gym.experiment.target import Target
from sada_gym.foundations.files import (
    MAX_JSON_BYTES,
    OneLine,
    Strict,
    as_path,
    first_error,
    read_file,
    write_model,
)
from sada_gym.parameters import Mu, Parameter, ParameterSpace

SUITE_FILE = "suite.json"
VERSION = 2
"""Suites of version 1 hold no ordinary worlds."""
ORDINARY = "ordinary worlds"

Verdict = Literal["pass", "fail"]
Objective = Literal["failure", "control", "ordinary"]
Seed = Annotated[int, Field(ge=0, lt=2**31)]


class Ranged(Strict):
    """A parameter of the logical scenario, with the fields of `sada_gym.Parameter`."""

    name: OneLine
    low: float
    high: float
    unit: OneLine = ""
    choices: tuple[OneLine, ...] = ()
    directions: tuple[OneLine, ...] = ()
    log: bool = False
    whole: bool = False

    @classmethod
    def of(cls, parameter: Parameter) -> Self:
        """Make the record of a parameter."""
        return cls(**{name: getattr(parameter, name) for name in cls.model_fields})

    def parameter(self) -> Parameter:
        """Return the parameter; raises a UserError if no parameter can have this range."""
        return Parameter(**dict(self))


class File(Strict):
    """A file as it was: its path, and its SHA-256."""

    path: str
    sha256: str


class Item(Strict):
    """The application and agent that a suite was exported from, and how to open them again.

    Attributes:
        opened_by: `id` (by the track's id), `toml` (by the text of the TOML file), or `python`
            (only the program that made the application can make it again).
        target: The track, the agent, the application's key and the fooling threshold.
        env_kwargs: The keywords given with the track's id.
        toml: The text of the TOML file that describes the application; None for an id.
        folder: The folder of that file, relative to the suite. Paths in the file start there.
        agent_file: The agent's file; None if the agent has a name.
        packages: Versions of the packages in use.
    """

    opened_by: Literal["id", "toml", "python"]
    target: Target
    env_kwargs: dict[str, Any]
    toml: str | None
    folder: str
    agent_file: File | None
    packages: dict[str, str]


class Case(Strict):
    """One world: a concrete scenario, and the result that is expected of the agent there.

    Attributes:
        objective: `failure`: the agent failed here; `control`: it passed in this similar world;
            `ordinary`: the world was drawn from ordinary use, whatever the agent did there.
        group: The number of its distinct failure, from 1. Ordinary worlds have one more than these.
        concrete_scenario: The physical values of the parameters by name.
        mu: The normalised parameters, (d,), exact as float32.
        seeds: The evaluation seeds, at least one; fresh ones if failures were confirmed.
        expected_result: `pass` or `fail`: the result when exported. Edit it to expect another one.
        fooled_seeds: On how many of the seeds the agent was fooled then.
    """

    id: OneLine
    objective: Objective
    group: int = Field(ge=1)
    concrete_scenario: dict[OneLine, float]
    mu: tuple[float, ...]
    seeds: tuple[Seed, ...] = Field(min_length=1)
    expected_result: Verdict
    fooled_seeds: int = Field(ge=0)


class Suite(Strict):
    """A regression suite. Its fields are named as in ISO 34501's vocabulary of test scenarios.

    Attributes:
        sources: The runs that its worlds come from.
        test_item: The application and agent that it was exported from.
        logical_scenario: The ranges of the parameters.
        pass_criterion: When a world counts as passed, in words.
        groups: What the worlds of each distinct failure have in common, in words.
        unconfirmed: How many failures were left out because they did not repeat on fresh seeds.
        unlucky_controls: How many controls were left out because they failed on fresh seeds.
        test_cases: The failures and their controls.
        ordinary_cases: Worlds drawn from the density of ordinary use; uniform without a density.
    """

    format: Literal["sada-gym regression suite"] = "sada-gym regression suite"
    version: Literal[1, 2] = 2
    sources: tuple[OneLine, ...]
    test_item: Item
    logical_scenario: tuple[Ranged, ...] = Field(min_length=1)
    pass_criterion: OneLine
    groups: tuple[OneLine, ...] = Field(min_length=1)
    unconfirmed: int
    unlucky_controls: int = Field(0, ge=0)
    test_cases: tuple[Case, ...] = Field(min_length=1)
    ordinary_cases: tuple[Case, ...] = ()

    @model_validator(mode="after")
    def _check_cases(self) -> Self:
        names = {parameter.name for parameter in self.logical_scenario}
        ids = [case.id for case in self.cases]
        if doubles := {id_ for id_ in ids if ids.count(id_) > 1}:
            raise ValueError(f"expected each id once, got {min(doubles)!r} twice")
        for case in self.cases:
            inside = all(-1.0 <= value <= 1.0 for value in case.mu)
            if len(case.mu) != len(names) or not inside or {*case.concrete_scenario} != names:
                raise ValueError(
                    f"expected {len(names)} values from -1 to 1 as mu of {case.id!r}, and the "
                    f"parameters {sorted(names)} in its concrete_scenario"
                )
            if case.fooled_seeds > len(case.seeds):
                raise ValueError(
                    f"expected at most {len(case.seeds)} fooled_seeds of {case.id!r}, as many as "
                    f"it has seeds, got {case.fooled_seeds}"
                )
            if case.group > len(self.groups) + (case.objective == "ordinary"):
                raise ValueError(f"expected a group of {case.id!r} up to {len(self.groups)}")
        told = criterion(self.test_item.target.fooling_threshold)
        if self.pass_criterion != told:
            raise ValueError(
                f"expected {told!r} as pass_criterion, got {self.pass_criterion!r}: it only says "
                "in words what the fooling_threshold of test_item's target decides"
            )
        return self

    @property
    def parameters(self) -> ParameterSpace:
        """The parameters, which convert mu to physical values."""
        return ParameterSpace(*(ranged.parameter() for ranged in self.logical_scenario))

    @property
    def cases(self) -> tuple[Case, ...]:
        """All worlds: failures, controls and ordinary ones."""
        return self.test_cases + self.ordinary_cases

    @property
    def mu(self) -> Mu:
        """All worlds, (n, d)."""
        return np.array([case.mu for case in self.cases], np.float32)


def criterion(threshold: float) -> str:
    """Say in words when a world counts as passed."""
    return f"Q > {threshold:g} for at least half of the seeds"


def suite_path(given: str | Path) -> Path:
    """Return a suite's file: `given` itself if it ends in .json, else `suite.json` in it."""
    path = as_path(given, "a suite")
    return path if path.suffix == ".json" else path / SUITE_FILE


def write_suite(path: Path, suite: Suite) -> None:
    """Write a suite's file, whole or not at all.

    Raises:
        FileError: If it cannot be written, or another suite lies there, which may be edited.
    """
    if path.exists() and read_suite(path)[1] != suite:
        raise FileError(
            f"Expected no other suite in {path}, got one with other content, which may have been "
            "edited. Remove it, or name another place by --out (out=)."
        )
    write_model(path, suite)


def read_suite(given: str | Path) -> tuple[Path, Suite]:
    """Read a suite's file or folder, and return the file's path and the suite.

    Raises:
        FileError: If the file is missing, truncated, of a later version, or contradicts itself.
    """
    path = suite_path(given)
    content = read_file(path, MAX_JSON_BYTES)
    expected = f"Expected a suite that `sada-gym export` wrote in {path}, got"
    try:
        raw = json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise FileError(
            f"{expected} no JSON: {error}. Restore the file, or export it again."
        ) from error
    version = raw.get("version") if isinstance(raw, dict) else None
    if isinstance(version, int) and version > VERSION:
        raise FileError(
            f"{expected} one of version {version}; this sada_gym reads versions up to {VERSION}. "
            "Update sada_gym."
        )
    try:
        suite = Suite.model_validate_json(content.decode("utf-8-sig"), strict=True)
    except ValidationError as error:
        raise FileError(
            f"{expected} another one ({first_error(error)}). Restore the file, or fix that place."
        ) from error
    _check_scenarios(path, suite)
    return path, suite


def _check_scenarios(path: Path, suite: Suite) -> None:
    """Raise a FileError where a world's physical values are not those of its mu."""
    parameters = suite.parameters
    spans = {ranged.name: ranged.high - ranged.low for ranged in suite.logical_scenario}
    for case, mu in zip(suite.cases, suite.mu, strict=True):
        for name, value in parameters.describe(mu).items():
            given = case.concrete_scenario[name]
            if abs(given - value) > 1e-3 * spans[name]:
                raise FileError(
                    f"Expected {name} of {case.id!r} in {path} to be {value:.6g}, which its mu "
                    f"says, got {given:.6g}. Edit both, or neither."
                )
