"""A run of an attack or of a benchmark is assembled here: its target, adversary and settings."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from sada_gym import adversaries
from sada_gym.adversaries.base import Adversary
from sada_gym.application import Application
from sada_gym.errors import UserError, UserTypeError
from sada_gym.evaluation.problems import make_application
from sada_gym.evaluation.store import Context
from sada_gym.experiment.ideal import IDEAL, Ideal
from sada_gym.experiment.packages import packages
from sada_gym.experiment.record import ReferenceSummary, RunSettings, json_compatible
from sada_gym.ids import names_file
from sada_gym.measures.reference import FOLDER, Reference, load_reference, read_index
from sada_gym.parameters import Mu
from sada_gym.registration import ids_of


@dataclass(frozen=True, eq=False)
class RunTarget:
    """An application under attack, with the reference set of its fooling worlds.

    Attributes:
        track: The environment's id, or a name for an application that has none.
        application: The application.
        reference: Its reference set; None where there is none.
    """

    track: str
    application: Application
    reference: Reference | None

    @property
    def dimension(self) -> int:
        """The number of semantic parameters."""
        return len(self.application.parameters)

    @cached_property
    def summary(self) -> ReferenceSummary | None:
        """What the settings say of the reference set."""
        return None if self.reference is None else ReferenceSummary.of(self.reference)

    @cached_property
    def split(self) -> tuple[Mu, Mu] | tuple[None, None]:
        """Fooling points to measure by and others to draw from; None where there are too few."""
        if self.reference is None or self.summary is None or not self.summary.usable:
            return None, None
        return self.reference.split()


def make_settings(
    target: RunTarget,
    adversary: str | type[Adversary],
    kind: type[Adversary],
    *,
    preset: str | None,
    options: Mapping[str, Any],
    budget: int,
    samples: int,
    seed: int,
    table: str = "",
    label: str | None = None,
    images: int = 0,
) -> RunSettings:
    """Write down all that decides a run's result.

    Args:
        target: What is attacked.
        adversary: The adversary's name or class, see `make_adversary`.
        kind: The class of the adversary that `make_adversary` made.
        preset: The named set of options that the adversary starts from.
        options: Its other options.
        budget: The number of training queries.
        samples: The number of test samples.
        seed: The seed of the adversary and of all evaluation seeds.
        table: The benchmark's table.
        label: What reports call the adversary; None takes its name.
        images: The number of samples whose nearest queries are compared as images.

    Raises:
        TypeError: If the options cannot be written as JSON.
        StoreError: If nothing identifies the application's agent.
    """
    context = Context.of(target.application)
    name = adversary if isinstance(adversary, str) else adversary.name
    return RunSettings(
        table=table,
        track=target.track,
        agent=target.application.agent_name,
        label=label or name,
        adversary=name,
        preset=preset,
        options=json_compatible(options),
        resolved=resolved_options(adversary, preset, options),
        budget=budget,
        samples=samples,
        seed=seed,
        images=images,
        application=context.name,
        version=context.version,
        application_settings=json.loads(context.settings),
        fingerprint=context.fingerprint,
        reference=target.summary,
        packages=packages(target.application, kind),
    )


def resolved_options(
    adversary: str | type[Adversary], preset: str | None, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Give all options of an adversary as JSON holds them: those given, the preset's, the defaults.

    Args:
        adversary: The adversary's name or class, see `make_adversary`. A class has no others than
            those given.
        preset: The named set of options that it starts from.
        options: Its other options.

    Raises:
        ValueError: If the name or the preset is unknown, or the options cannot be written as JSON.
    """
    if isinstance(adversary, str) and adversary != IDEAL:
        return json_compatible(adversaries.resolve(adversary, _keywords(preset, options)))
    return json_compatible(options)


def make_adversary(
    adversary: str | type[Adversary],
    dimension: int,
    *,
    seed: int,
    preset: str | None,
    options: Mapping[str, Any],
    ideal_set: Mu | None,
) -> Adversary:
    """Make the adversary of a run.

    Args:
        adversary: A registered name, `module:Class`, `ideal`, or a class.
        dimension: The number of semantic parameters, d.
        seed: The adversary's seed.
        preset: The named set of options to start from.
        options: Its other options; they replace the preset's.
        ideal_set: (R, d) points known to fool, which `ideal` draws from.

    Raises:
        TypeError, ValueError: If the adversary or an option is unknown.
    """
    taken = sorted({"name", "dimension", "seed"} & set(options))
    if taken:
        raise UserError(
            f"Expected the adversary's own options, got {taken[0]!r}, which the run sets itself."
        )
    keywords = _keywords(preset, options)
    if adversary == IDEAL:
        if keywords:
            raise UserError(f"Expected {IDEAL} without options, got {keywords}. Drop them.")
        if ideal_set is None:
            raise UserError(
                f"Expected {IDEAL} on a track that has a reference set, got one without. Choose "
                "another adversary."
            )
        return Ideal(dimension, seed=seed, fooling_set=ideal_set)
    if isinstance(adversary, str):
        return adversaries.make(adversary, dimension, seed=seed, **keywords)
    if not (isinstance(adversary, type) and issubclass(adversary, Adversary)):
        raise UserTypeError(f"Expected an adversary's name or class, got {adversary!r}.")
    return adversary(dimension, seed=seed, **keywords)


def _keywords(preset: str | None, options: Mapping[str, Any]) -> dict[str, Any]:
    """Merge a preset and the options that replace some of its own."""
    return {**({} if preset is None else {"preset": preset}), **options}


def find_target(
    environment: str | Application, env_kwargs: Mapping[str, Any], application: Application
) -> RunTarget:
    """Find the shipped reference set, if any, of exactly what an attack attacks.

    It is that of the same track, whether the attack names it by its id, by keywords of a general
    id, or by an `Application`. Other settings, such as another image size, have none.

    Args:
        environment: The environment's id, a TOML file, or the application itself.
        env_kwargs: Keywords of the id.
        application: The application, made of both.
    """
    name = f"{application.name}-v{application.version}"
    # the record does not depend on where a file lies
    is_id = isinstance(environment, str) and not names_file(environment)
    track = str(environment) if is_id else name
    made_of = (application.agent_name, application.version, application.fingerprint)
    fixed = ids_of(application.name)
    for entry in read_index(FOLDER).references:
        if (entry.agent, entry.version, entry.fingerprint) != made_of or entry.track not in fixed:
            continue
        keywords = fixed[entry.track].items()
        if any(application.settings.get(key) != value for key, value in keywords):
            continue
        # making an application takes half a second, and is only needed where settings may differ
        plain = environment == entry.track and set(env_kwargs) <= {"agent"}
        if plain or _has_settings(entry.track, application):
            return RunTarget(track, application, load_reference(entry.track, application))
    return RunTarget(track, application, None)


def _has_settings(track: str, application: Application) -> bool:
    with closing(open_application(track, application.agent_name)) as other:
        return (other.name, other.settings) == (application.name, application.settings)


def open_application(track: str, agent: str) -> Application:
    """Open a track with an agent that a result names."""
    application = make_application(track)
    if application.agent_name == agent:
        return application
    application.close()
    return make_application(track, agent=agent)
