"""Checks an application, ours or a user's own, against the contract: `sada-gym check`."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from gymnasium.utils.env_checker import check_env

from sada_gym.application import Application
from sada_gym.envs.adversary import AdversaryEnv
from sada_gym.errors import UserError, described, explained
from sada_gym.evaluation.problems import make_application, make_env
from sada_gym.foundations.ids import names_file
from sada_gym.testing import rules
from sada_gym.testing.processes import import_file

_CHECKS: Mapping[str, Callable[[Application], str]] = {
    "declaration": rules.check_declaration,
    "scores and infos": rules.check_outcomes,
    "randomness": rules.check_randomness,
    "bad input": rules.check_bad_input,
    "live parameters": rules.check_live_parameters,
    "purity": rules.check_purity,
    "another process": rules.check_other_process,
    "pictures": rules.check_pictures,
}


OnCheck = Callable[[str, Sequence["Check"]], object]
"""Gets the name of each check before it runs, and what those before it found."""

_PARAGRAPH = 120
"""Shorter sentences are told at each check that finds them."""


@dataclass(frozen=True)
class Check:
    """One check and its finding: of a failed one, what was expected and what came."""

    name: str
    passed: bool
    sentence: str


@dataclass(frozen=True)
class CheckReport:
    """The checks of one application, an id or a class, in the order in which they ran."""

    subject: str
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)


def check_application(
    application: Application,
    *,
    env: AdversaryEnv | None = None,
    subject: str | None = None,
    on_check: OnCheck = lambda name, found: None,  # noqa: ARG005
) -> CheckReport:
    """Check an application against the contract; what it raises becomes a failed check.

    Args:
        application: The application.
        env: The environment around it; by default a plain `AdversaryEnv`.
        subject: What the report calls it; by default a user's class, or the name of one of ours.
        on_check: See `OnCheck`.
    """
    checks: list[Check] = []

    def run(name: str, check: Callable[[], str]) -> None:
        on_check(name, tuple(checks))
        checks.append(_run(name, check))

    declared, *rest = _CHECKS.items()
    run(declared[0], partial(declared[1], application))
    if checks[0].passed:  # nothing else makes sense without
        env = AdversaryEnv(application) if env is None else env
        for name, check in rest:
            run(name, partial(check, application))
        run("environment", partial(rules.check_environment_steps, env))
        run("check_env of Gymnasium", partial(_check_gymnasium, env))
        run("check_env of Stable-Baselines3", partial(_check_sb3, env))
        run("closing", partial(_check_closing, env))
    kind = type(application)
    if subject is None and kind.__module__.startswith("sada_gym."):
        subject = f"{application.name}-v{application.version}"
    return CheckReport(subject or kind.__name__, tuple(_told_once(checks)))


def _told_once(checks: Sequence[Check]) -> Iterator[Check]:
    """Tell what several checks found at one of them; the others name it."""
    failed = [check for check in checks if not check.passed]
    for check in checks:
        same = [other.name for other in failed if _gist(other) == _gist(check)]
        teller = "randomness" if "randomness" in same else next(iter(same), check.name)
        told = check.passed or check.name == teller
        yield check if told else replace(check, sentence=f"See {teller}: it fails by the same.")


def _gist(check: Check) -> str:
    gist = check.sentence.partition(", but")[0]  # behind it stand values, which chance changes
    return gist if len(check.sentence) > _PARAGRAPH else check.name


def check_environment(
    env_id: str,
    *,
    on_check: OnCheck = lambda name, found: None,  # noqa: ARG005
    **env_kwargs: Any,
) -> list[CheckReport]:
    """Check the application and environment behind a registered id, or of a TOML file.

    `on_check` is told what goes on, see `OnCheck`.

    Raises:
        ValueError: If the id or a keyword is unknown, or it is no adversary environment.
    """
    if names_file(env_id):
        application = make_application(env_id, **env_kwargs)
        return [check_application(application, subject=env_id, on_check=on_check)]
    env = make_env(env_id, **env_kwargs)
    if not isinstance(env, AdversaryEnv):
        raise UserError(
            f"Expected an AdversaryEnv behind {env_id!r}, got {type(env).__name__}. Check a file "
            "with its application instead: sada-gym check FILE.py."
        )
    return [check_application(env.application, env=env, subject=env_id, on_check=on_check)]


def check_file(
    path: str | Path,
    *,
    on_check: OnCheck = lambda name, found: None,  # noqa: ARG005
) -> list[CheckReport]:
    """Check all applications of a Python file, see `load_applications` and `OnCheck`."""
    return [check_application(one, on_check=on_check) for one in load_applications(path)]


def load_applications(path: str | Path) -> list[Application]:
    """Get the applications that a Python file defines.

    These are the instances at the module's top level, and an instance, made without arguments, of
    each class defined there that has none. A class without a `name` counts as a base for others.

    Raises:
        ValueError: If the file can't be imported, a class needs arguments, or there is none.
    """
    module = import_file(path)
    members = list(vars(module).values())
    applications = list({id(m): m for m in members if isinstance(m, Application)}.values())
    for member in members:
        if (
            inspect.isclass(member)
            and issubclass(member, Application)
            and member.__module__ == module.__name__
            and not inspect.isabstract(member)
            and hasattr(member, "name")
            and not any(type(application) is member for application in applications)
        ):
            expected = f"Expected {member.__name__} in {str(path)!r} to be made without arguments"
            with explained(expected, "Add an instance at the file's top level instead."):
                applications.append(member())
    if not applications:
        raise UserError(
            f"Expected a subclass of sada_gym.Application with a `name` in {str(path)!r}, found "
            "none. Define one at the file's top level."
        )
    return applications


def _run(name: str, check: Callable[[], str]) -> Check:
    try:
        return Check(name, True, check())
    except AssertionError as error:
        return Check(name, False, str(error) or "An assertion without a message failed.")
    except Exception as error:  # a user's code may raise anything, and that is a finding
        return Check(name, False, described(error))


def _check_gymnasium(env: AdversaryEnv) -> str:
    can_render = env.application.can_render
    return _passes(partial(check_env, env, skip_render_check=env.spec is None or not can_render))


def _check_sb3(env: AdversaryEnv) -> str:
    from stable_baselines3.common.env_checker import check_env as check_env_sb3

    return _passes(partial(check_env_sb3, env))


def _passes(check: Callable[[], None]) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check()
    return "Passes without a warning."


def _check_closing(env: AdversaryEnv) -> str:
    env.close()
    env.close()
    return "Closing twice is fine."
