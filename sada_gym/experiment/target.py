"""What an experiment attacks: a record, and the same with its application open."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from contextlib import closing
from functools import cached_property
from pathlib import Path
from typing import Any

from typing_extensions import Self

from sada_gym import agents
from sada_gym.application import Application
from sada_gym.errors import UserError, UserTypeError
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.experiment.differences import differences
from sada_gym.experiment.names import card_of
from sada_gym.foundations.files import Strict, shown
from sada_gym.foundations.ids import names_file
from sada_gym.foundations.registration import ids_of
from sada_gym.measures.coverage import NEAREST
from sada_gym.measures.reference import FOLDER, Reference, load_reference, read_index
from sada_gym.parameters import Mu


class ReferenceSummary(Strict):
    """The reference set that a result is measured against.

    Attributes:
        points: The number of its points, which are uniform in the box.
        fooling: How many points belong to the fooling set.
        uniform_rate: The share of their evaluations that fooled: the AFR of uniform samples.
    """

    sha256: str
    points: int
    fooling: int
    uniform_rate: float

    @classmethod
    def of(cls, reference: Reference) -> Self:
        """Describe a reference set."""
        return cls(
            sha256=reference.entry.sha256,
            points=reference.entry.points,
            fooling=int(reference.fooling.sum()),
            uniform_rate=reference.uniform_rate,
        )

    @property
    def usable(self) -> bool:
        """Whether half of the fooling set is enough points to measure coverage."""
        return self.fooling // 2 > NEAREST


class Target(Strict):
    """What is attacked: a track's application with one agent.

    Attributes:
        track: The environment's id, or a name for an application without an id.
        agent: The agent's name; empty if the application has none.
        fooling_threshold: The agent is fooled if Q <= this.
    """

    track: str
    agent: str
    application: ApplicationKey
    fooling_threshold: float
    reference: ReferenceSummary | None

    @classmethod
    def of(
        cls, application: Application, track: str = "", *, reference: Reference | None = None
    ) -> Self:
        """Describe an application; raises a StoreError if nothing identifies its agent."""
        return cls(
            track=track or f"{application.name}-v{application.version}",
            agent=application.agent_name,
            application=ApplicationKey.of(application),
            fooling_threshold=float(application.fooling_threshold),
            reference=None if reference is None else ReferenceSummary.of(reference),
        )

    def __str__(self) -> str:
        """Name the target for people."""
        return f"{self.track} against {self.agent}" if self.agent else self.track

    def open(
        self, environment: str | Application | None = None, *, workers: int | Workers = 1
    ) -> OpenTarget:
        """Open the application again, and check that it is the same.

        Args:
            environment: The id, the TOML file or the application; None takes the track's id.
            workers: See :class:`~sada_gym.Workers`.

        Raises:
            UserError: If it cannot be opened, or is not the same.
        """
        if environment is None or _is_id(environment):
            return self.opened(self._reopened(str(environment or self.track), workers))
        return self.opened(Evaluator(environment, workers=workers))

    def opened(self, evaluator: Evaluator) -> OpenTarget:
        """Use an open evaluator of the same application; raises a UserError for another one."""
        try:
            application = evaluator.application
            if application is None:
                raise UserTypeError(
                    f"Expected an application, an id or a TOML file, got a function for {self}."
                )
            then, now = self.application, ApplicationKey.of(application)
            changes = differences(
                {"agent": self.agent, **then.model_dump()},
                {"agent": application.agent_name, **now.model_dump()},
            )
            if changes:
                raise UserError(
                    f"Expected {shown(str(self))} as it was attacked, got another: "
                    f"{shown('; '.join(changes))}."
                )
        except BaseException:
            evaluator.close()
            raise
        return OpenTarget(self, evaluator)

    def env_kwargs(self) -> dict[str, Any]:
        """Return the keywords given with the id; raises a UserError if it cannot be opened."""
        with closing(_open(self.track, {}, self.agent)) as evaluator:
            return self._keywords(evaluator)

    def _reopened(self, track: str, workers: int | Workers) -> Evaluator:
        evaluator = _open(track, {}, self.agent, workers=workers)
        keywords = self._keywords(evaluator)
        if not keywords:
            return evaluator
        evaluator.close()
        return _open(track, keywords, self.agent, workers=workers)

    def _keywords(self, plain: Evaluator) -> dict[str, Any]:
        """Find the keywords that tell the target from its track without any."""
        application = plain.application
        assert application is not None
        now = ApplicationKey.of(application).settings
        # a setting may follow from others, and be no keyword
        accepted = inspect.signature(type(application)).parameters
        return {
            name: value
            for name, value in self.application.settings.items()
            if now.get(name) != value and name in accepted
        }


class OpenTarget:
    """A target with its application open; a context manager that closes it.

    What does not need the application stays there when it is closed: the semantic `parameters`,
    M as `sample_size`, and the reference set, which is read from the folder `references`.
    """

    def __init__(self, target: Target, evaluator: Evaluator, references: Path = FOLDER) -> None:
        self.target = target
        self._evaluator: Evaluator | None = evaluator
        self._references = references
        self.parameters = self.application.parameters
        self.sample_size = self.application.sample_size

    @classmethod
    def of(
        cls,
        environment: str | Application,
        env_kwargs: Mapping[str, Any] | None = None,
        *,
        agent: str | None = None,
        references: Path = FOLDER,
        workers: int | Workers = 1,
    ) -> Self:
        """Open what a user names, and describe it.

        The reference set is the shipped one of the same track, whether the track is named by its
        id, by keywords of a general id, or by an `Application`. Other settings, such as another
        image size, have none. Without an agent's name it takes what the rest says; `Evaluator`
        explains the workers.

        Raises:
            TypeError, ValueError: If it cannot be opened.
        """
        keywords = dict(env_kwargs or {})
        evaluator = _open(environment, keywords, agent, workers=workers)
        try:
            application = evaluator.application
            if application is None:
                raise UserTypeError(
                    "Expected an environment id or an Application to attack, got "
                    f"{environment!r}. Wrap a function in an Application: it has parameters and "
                    "an agent to name."
                )
            # the record does not depend on where a file lies
            track = str(environment) if _is_id(environment) else ""
            reference = _find_reference(application, track, keywords, references)
            return cls(Target.of(application, track, reference=reference), evaluator, references)
        except BaseException:
            evaluator.close(now=True)
            raise

    @property
    def evaluator(self) -> Evaluator:
        """What scores the application; a RuntimeError if the target is closed."""
        if self._evaluator is None:
            raise RuntimeError(f"{self.target} is closed.")
        return self._evaluator

    @property
    def application(self) -> Application:
        """The application."""
        application = self.evaluator.application
        assert application is not None
        return application

    @property
    def dimension(self) -> int:
        """The number of semantic parameters, d."""
        return len(self.parameters)

    @cached_property
    def reference(self) -> Reference | None:
        """The reference set; None where there is none."""
        summary = self.target.reference
        if summary is None:
            return None
        for entry in read_index(self._references).references:
            if entry.sha256 == summary.sha256:
                return load_reference(entry.track, self.application, self._references)
        raise UserError(
            f"Expected the reference set {summary.sha256} of {self.target} in {self._references}, "
            "got none. Restore the folder."
        )

    @property
    def fooling_points(self) -> Mu | None:
        """All points of the reference set that fool, (R, d); None where there are too few."""
        summary, reference = self.target.reference, self.reference
        if summary is None or reference is None or not summary.usable:
            return None
        return reference.fooling_set

    @cached_property
    def _split(self) -> tuple[Mu, Mu] | tuple[None, None]:
        if self.fooling_points is None or self.reference is None:
            return None, None
        return self.reference.split()

    @property
    def fooling_set(self) -> Mu | None:
        """The fooling points to measure coverage by, (R, d); None where there are too few."""
        return self._split[0]

    @property
    def ideal_set(self) -> Mu | None:
        """Other fooling points, to draw ideal samples from; None where there are too few."""
        return self._split[1]

    def close(self, *, now: bool = False) -> None:
        """Close the application and stop its workers; `now` drops running evaluations."""
        evaluator, self._evaluator = self._evaluator, None
        if evaluator is not None:
            evaluator.close(now=now)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Close the application."""
        self.close(now=kind is not None)


def _is_id(environment: object) -> bool:
    return isinstance(environment, str) and not names_file(environment)


def _open(
    environment: str | Application, keywords: Mapping[str, Any], agent: str | None, **options: Any
) -> Evaluator:
    """Open an environment with an agent, which needs no keyword where it is the default."""
    if not isinstance(environment, str) or not agent:
        return Evaluator(environment, env_kwargs=keywords, **options)
    card = card_of(environment) if _is_id(environment) else None
    if card is None or agent not in agents.names(card.name)[1:]:
        evaluator = Evaluator(environment, env_kwargs=keywords, **options)
        if evaluator.application is None or evaluator.application.agent_name == agent:
            return evaluator
        evaluator.close()
    return Evaluator(environment, env_kwargs={**keywords, "agent": agent}, **options)


def _find_reference(
    application: Application, track: str, keywords: Mapping[str, Any], folder: Path
) -> Reference | None:
    """Find the reference set of exactly this application with its agent and settings.

    One of another version of the track or of its agent is a UserError.
    """
    if track and not keywords:
        reference = load_reference(track, application, folder)
        if reference is not None:
            return reference
    made_of = (application.agent_name, application.version, application.fingerprint)
    fixed = ids_of(application.name)
    for entry in read_index(folder).references:
        if (entry.agent, entry.version, entry.fingerprint) != made_of or entry.track not in fixed:
            continue
        if any(application.settings.get(k) != v for k, v in fixed[entry.track].items()):
            continue
        # to make an application takes half a second, and is only needed where settings may differ
        plain = track == entry.track and set(keywords) <= {"agent"}
        if plain or _has_settings(entry.track, application):
            return load_reference(entry.track, application, folder)
    return None


def _has_settings(track: str, application: Application) -> bool:
    with closing(_open(track, {}, application.agent_name)) as evaluator:
        other = evaluator.application
        assert other is not None
        return (other.name, other.settings) == (application.name, application.settings)
