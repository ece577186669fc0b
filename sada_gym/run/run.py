"""The run that an attack leaves: its settings, figures, worlds and findings, out of its folder."""

from __future__ import annotations

import csv
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

from sada_gym.application import Application
from sada_gym.errors import FileError, UserError, UserTypeError, plain
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluations import Evaluations, evaluation_seeds
from sada_gym.experiment.record import RunReport, RunSettings
from sada_gym.experiment.target import OpenTarget, Target
from sada_gym.foundations.files import as_path, read_model, shown
from sada_gym.measures.diagnosis.record import Diagnosis, diagnosed_before
from sada_gym.measures.failures import Failures, listed_before
from sada_gym.measures.likelihood import FailureEstimate, estimated_before
from sada_gym.parameters import ParameterSpace
from sada_gym.run.folder import (
    ADVERSARY_FOLDER,
    REPORT_FILE,
    RESULT_FILE,
    SAMPLES_FILE,
    SETTINGS_FILE,
    STORE_FILE,
    is_saved,
    read_record,
    read_samples,
)
from sada_gym.run.given import Given
from sada_gym.run.summary import laid_out, summary_rows, title
from sada_gym.run.worlds import WORLDS_FILE, read_columns


@dataclass(frozen=True, repr=False, eq=False)
class Run:
    """A finished run; `print` shows its summary.

    `diagnosis`, `failures` and `estimate` are read from the folder each time.

    Attributes:
        folder: The folder that `attack` wrote.
        settings: The settings of the run: experiment, label and versions of packages.
        given: The environment as the caller gave it: an id, a TOML file, or an application.
        samples: The M test samples.
        was_finished: Whether the run was finished before, so that `attack` evaluated nothing.
        kept: Keeps a temporary folder alive as long as the run.
    """

    folder: Path
    settings: RunSettings
    given: Given
    samples: Evaluations
    was_finished: bool = False
    kept: object = None  # a temporary folder lives as long as this

    @property
    def target(self) -> Target:
        """The track, the agent, the fooling threshold and the reference set."""
        return self.settings.experiment.target

    @property
    def name(self) -> str:
        """The name of its folder."""
        return plain(self.folder.absolute().name)

    @cached_property
    def result(self) -> RunReport:
        """The contents of result.json. Raises a FileError if damaged or of another version."""
        return read_model(self.folder / RESULT_FILE, RunReport)

    @cached_property
    def queries(self) -> Evaluations | None:
        """The training queries (Omega); None if run.sqlite does not hold all of them.

        Raises a StoreError if another process has run.sqlite open.
        """
        count = self.settings.experiment.protocol.budget
        with suppress(FileError):
            count = self.result.search.queries
        if not count:
            return Evaluations.empty(self.samples.mu.shape[1])
        if not (self.folder / STORE_FILE).is_file():
            return None
        seeds = evaluation_seeds(self.settings.seed, "train", 0, count)
        with EvaluationStore(self.folder / STORE_FILE) as store:
            return store.evaluations(store.context(self.target.application), seeds)

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The diagnosis with its weaknesses; None if there is none, or it cannot be read."""
        return diagnosed_before(self.folder)

    @property
    def failures(self) -> Failures | None:
        """The failures among the samples; None if there are none, or they cannot be read."""
        return listed_before(self.folder)

    @property
    def estimate(self) -> FailureEstimate | None:
        """The result of `estimate`, if it was called for this run; otherwise None."""
        return estimated_before(self.folder)

    @property
    def parameters(self) -> ParameterSpace | None:
        """The parameters; None if worlds.json does not name them."""
        columns = read_columns(self.folder)
        return None if columns is None else columns.space

    @property
    def html(self) -> Path | None:
        """The path of report.html; None if there is none."""
        path = self.folder / REPORT_FILE
        return path if path.is_file() else None

    @property
    def pictures(self) -> tuple[Path, ...]:
        """The paths of the pictures."""
        return tuple(sorted(self.folder.glob("*.png")))

    @property
    def files(self) -> tuple[Path, ...]:
        """The paths of the report and of the pictures."""
        return (*(() if self.html is None else (self.html,)), *self.pictures)

    @property
    def adversary_folder(self) -> Path:
        """The folder of the trained adversary."""
        return self.folder / ADVERSARY_FOLDER

    def worlds(self) -> Any:
        """Return worlds.csv, the samples and queries in physical units.

        It is a pandas DataFrame if pandas is installed, otherwise a list of dictionaries.

        Raises:
            FileError: If the folder has no worlds.csv.
        """
        path = self.folder / WORLDS_FILE
        if not path.is_file():
            raise FileError(
                f"Expected {WORLDS_FILE} in {self.folder}, got none. Make it by `sada-gym report "
                f"{self.folder}`."
            )
        try:
            pandas: Any = import_module("pandas")
        except ImportError:
            with path.open(newline="", encoding="utf-8") as file:
                return [{k: _cell(v) for k, v in row.items()} for row in csv.DictReader(file)]
        return pandas.read_csv(path)

    def open(
        self,
        application: Application | str | None = None,
        *,
        workers: int | Workers = 1,
    ) -> OpenTarget:
        """Open what the run attacked, and check that it is the same application and agent.

        Args:
            application: The application, an environment's id or a TOML file. It is only needed for
                an application that was made in Python, which the run cannot record.
            workers: See :class:`~sada_gym.Workers`.

        Raises:
            UserError: If it cannot be opened, or differs from what the run attacked.
        """
        if not isinstance(application, Application | str | None):
            raise UserTypeError(
                f"Expected an Application, an environment's id or a TOML file, got {application!r}."
            )
        fix = (
            "If a TOML file describes it, name that by --application FILE.toml. If you made it in "
            "Python, hand it over: application=YOURS."
        )
        if application is None and self.given.by == "python":
            raise UserError(
                f"Expected a run whose settings can open what it attacked, got that of "
                f"{self.folder}: it attacked {shown(self.target.track)} in an application of "
                f"yours. {fix}"
            )
        try:
            opened = self._opened(application, workers)
        except UserError as error:
            raise UserError(
                f"Expected to open {shown(str(self.target))} as the run in {self.folder} did, but: "
                f"{error} {fix}"
            ) from error
        try:
            self.check_samples(opened)
        except BaseException:
            opened.close()
            raise
        return opened

    def check_samples(self, opened: OpenTarget) -> None:
        """Raise a UserError unless the samples are worlds of what was opened."""
        if self.samples.mu.shape[1] != opened.dimension:
            raise UserError(
                f"Expected samples of {opened.dimension} parameters, got "
                f"{self.samples.mu.shape[1]}. The run's {SAMPLES_FILE} is of another run."
            )
        opened.parameters.validate(self.samples.mu)

    def _opened(self, application: Application | str | None, workers: int | Workers) -> OpenTarget:
        if application is None:
            application, keywords = self.given.environment(), self.given.keywords
            if self.given.by == "id" and keywords is not None:
                return self.target.opened(
                    Evaluator(str(application), env_kwargs=keywords, workers=workers)
                )
        return self.target.open(application, workers=workers)

    def env_kwargs(self) -> dict[str, Any]:
        """Return the keywords of its id; a UserError where only opening it tells, and it fails."""
        known = self.given.keywords
        return self.target.env_kwargs() if known is None else dict(known)

    def open_changed(
        self, env_kwargs: Mapping[str, Any], *, agent: str | None = None, **options: Any
    ) -> OpenTarget:
        """Open the same track with other keywords, or another agent, than the run attacked.

        All other keywords stay. `options` are those of `OpenTarget.of`, whose errors it raises.
        """
        keywords = {**self.env_kwargs(), **env_kwargs}
        own = keywords.pop("agent", self.target.agent)
        return OpenTarget.of(self.target.track, keywords, agent=agent or own, **options)

    @property
    def title(self) -> str:
        """What was attacked, and how."""
        return title(self.result, self.given.agent)

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield the name and the text, of one or more lines, of each finding."""
        yield from summary_rows(
            self.result,
            diagnosis=self.diagnosis,
            failures=self.failures,
            space=self.parameters,
            likely=self.estimate,
        )

    def further(self) -> Iterator[tuple[str, str]]:
        """Yield which file to open, and the next two commands, or calls where Python has it."""
        first = self.files[0].name if self.files else RESULT_FILE
        yield "open", str(self.folder / first)
        if commands := list(islice(self.commands(str(self.folder)), 2)):
            yield "next", "\n".join(commands)

    def commands(self, folder: str) -> Iterator[str]:
        """Yield what to do next with a run that lies in this folder, the most useful first."""
        failures, diagnosis = self.failures, self.diagnosis
        columns = read_columns(self.folder)
        if failures is None:
            sizes = self.settings.experiment.protocol
            if columns is not None and sizes.budget and columns.command:
                longer = f"--budget {4 * sizes.budget}"
                yield columns.command.replace(f"--budget {sizes.budget}", longer)
            return
        steps = []
        if failures.confirmed is None:
            steps.append(("confirm", "--seeds 2", "diagnose", "confirm=2"))
        if diagnosis is not None and not all(one.is_checked for one in diagnosis.weaknesses):
            steps.append(("diagnose", "--fresh 200", "diagnose", "fresh=200"))
        if (self.folder / "fooled.png").is_file():
            steps.append(("replay", "--out failure.gif", "replay", "out='failure.gif'"))
        steps.append(("export", "--out suite.json", "export", "out='suite.json'"))
        for command, options, call, keyword in steps:
            if self.given.by == "python":
                yield f"sada_gym.{call}({folder!r}, {keyword}, application=YOURS)"
            else:
                yield f"sada-gym {command} {shlex.quote(folder)} {options}"

    def __repr__(self) -> str:
        """Write the summary: how often the agent fails, where, and what to do next."""
        lines = laid_out([*self.rows(), *self.further()])
        return "\n".join([self.title, *(f"{lead}{text}" for _, lead, text in lines)])


def load_run(folder: str | Path) -> Run:
    """Read a run that `attack` finished.

    Raises:
        FileError: If the folder holds no run, the run is not finished, or a file is damaged.
    """
    path = as_path(folder, "a run's folder")
    if not (path / SETTINGS_FILE).is_file():
        raise FileError(
            f"Expected a folder that `sada-gym attack` wrote, got {path}, which holds no "
            f"{SETTINGS_FILE}. Name the folder that --out (out=) named."
        )
    record = read_record(path)
    if not (path / SAMPLES_FILE).exists():
        raise FileError(
            f"Expected the run in {path} to be finished, got no {SAMPLES_FILE} in it. Finish it "
            "with --resume (resume=True)."
        )
    samples = read_samples(path / SAMPLES_FILE)
    if not len(samples):
        raise FileError(f"Expected samples in {path / SAMPLES_FILE}, got none.")
    return Run(path, record.settings, record.given, samples)


def read_finished(folder: Path, settings: RunSettings, dimension: int) -> Run | None:
    """Read a run of these settings to which nothing is missing; None where anything is.

    To go on with such a run makes the missing or damaged file again.

    Raises:
        StoreError: If another process has the run's store open.
    """
    if not is_saved(folder / ADVERSARY_FOLDER) or not (folder / STORE_FILE).exists():
        return None
    try:
        run = replace(load_run(folder), was_finished=True)
        is_same = run.result.settings == settings
    except FileError:
        return None
    shape = (settings.experiment.protocol.samples, dimension)
    return run if is_same and run.samples.mu.shape == shape and run.queries is not None else None


def as_run(run: Run | str | Path) -> Run:
    """Return a run that is named by itself or by its folder; see `load_run`."""
    return run if isinstance(run, Run) else load_run(run)


def as_runs(runs: Run | str | Path | Sequence[Run | str | Path]) -> list[Run]:
    """Return a run, or several; a UserError for anything else, or for none."""
    listed = [runs] if isinstance(runs, Run | str | Path) else runs
    if not isinstance(listed, Sequence) or not all(
        isinstance(run, Run | str | Path) for run in listed
    ):
        raise UserTypeError(f"Expected a run's folder or a list of them, got {runs!r}.")
    if not listed:
        raise UserError("Expected at least one run, got none. Name the folder of one.")
    return [as_run(run) for run in listed]


def _cell(text: str) -> int | float | str:
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return text
