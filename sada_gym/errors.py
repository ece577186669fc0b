"""The errors that this package raises on purpose."""

from __future__ import annotations

import difflib
import operator
import re
import traceback
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import PurePath

_LONGEST = 300
_ADDRESS = re.compile(r"\b0x[0-9a-fA-F]{6,}\b")
_OBEYED = {"Cc", "Cs", "Zl", "Zp"}
_TURNING = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}


class UserError(ValueError):
    """A bad input. The message says what was expected, what was given, and how to fix it."""


class UserTypeError(UserError, TypeError):
    """A bad input of the wrong type."""


class InvalidWorld(UserError):  # noqa: N818 - reads as what happened
    """A world that its simulator cannot compute; `reason` says why in one line, without the mu."""

    def __init__(self, message: str, reason: str = "") -> None:
        super().__init__(message)
        self.reason = plain(reason or message)


class FileError(UserError):
    """A file that cannot be read or written."""


class MissingPart(FileError):  # noqa: N818 - reads as what happened
    """A file of another project that is not installed; the message says how to get it."""


class StoreError(UserError):
    """An evaluation store that cannot be used: no store, corrupt, in use, or another version."""


class StoreInUse(StoreError):  # noqa: N818 - reads as what happened
    """An evaluation store that another process has open."""


class MissingExtra(UserError, ModuleNotFoundError):  # noqa: N818 - reads as what happened
    """An optional package that is not installed; the message names the extra to install."""


def install_line(extra: str) -> str:
    """Say how to install an extra: from a clone, for no index has the package."""
    return f"In a clone of sada_gym run: pip install -c constraints.txt '.[{extra}]'"


class AdversaryError(UserError):
    """An adversary that cannot train or sample with these parameters, options or scores."""


class BudgetTooSmall(AdversaryError):  # noqa: N818 - reads as what happened
    """Fewer queries than the adversary can learn from."""


class TrainingDiverged(AdversaryError):  # noqa: N818 - reads as what happened
    """The weights or losses of a training are no longer finite numbers."""


class BudgetExhausted(RuntimeError):  # noqa: N818 - reads as what happened
    """More queries were asked for than are left; none of them was evaluated."""


class Notice(UserWarning):
    """A warning about a result; the command line shows it as one sentence."""


class SlowWorlds(Notice):
    """Evaluations will take long: the warning says about how long."""


class WorkerError(RuntimeError):
    """A worker process died or could not load what it should evaluate."""


class AgentLost(WorkerError):  # noqa: N818 - reads as what happened
    """An agent in a separate process died, stalled or gave a malformed answer."""


class ServerLost(WorkerError):  # noqa: N818 - reads as what happened
    """A simulator's server died or stopped answering."""


def check_integer(name: str, value: object, minimum: int, maximum: int | None = None) -> None:
    """Raise `UserError` for anything but a whole number from minimum to maximum, if there is one.

    `name` is the number's name in the message.
    """
    try:
        if isinstance(value, bool):
            raise TypeError("a bool is not a number")
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError as error:
        raise UserTypeError(f"Expected {name} to be a whole number, got {value!r}.") from error
    if number < minimum:
        raise UserError(f"Expected {name} of at least {minimum}, got {number}.")
    if maximum is not None and number > maximum:
        raise UserError(f"Expected {name} of at most {maximum:,}, got {number:,}.")


def check_keywords(name: str, value: object) -> None:
    """Raise `UserTypeError` for anything but a mapping whose keys are texts."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise UserTypeError(f"Expected {name} by name, such as {{'steps': 10}}, got {value!r}.")


def check_known(what: str, given: Iterable[object], known: Sequence[str]) -> None:
    """Raise UserError for the first of the given names that is not known, with close matches."""
    for name in given:
        if name not in known:
            names = [*map(str, known)]  # keys of a user's may be numbers
            close = difflib.get_close_matches(str(name), names, n=3)
            hint = f" Did you mean {' or '.join(close)}?" if close else ""
            listed = f"one of {', '.join(names)}" if names else "none"
            raise UserError(f"Expected the {what} to be {listed}; got {name!r}.{hint}")


def is_plain(text: str) -> bool:
    """Say whether a text is in one line, and holds nothing that a terminal obeys.

    These are control characters, lone surrogates, and what turns the direction of writing. Letters,
    spaces and emoji of any kind are plain.
    """
    return text.isprintable() or not any(map(_is_obeyed, text))


def plain(text: str) -> str:
    """Escape what is not plain, such as line breaks; UTF-8 can hold the result."""
    if is_plain(text):
        return text
    escaped = (c.encode("unicode_escape").decode() if _is_obeyed(c) else c for c in text)
    return "".join(escaped)


def _is_obeyed(character: str) -> bool:
    kind, direction = unicodedata.category(character), unicodedata.bidirectional(character)
    return kind in _OBEYED or direction in _TURNING


def check_plain(what: str, text: str) -> None:
    """Raise `UserError` for a text of a user's that is not plain; `what` names it."""
    if not isinstance(text, str) or not is_plain(text):
        raise UserError(
            f"Expected {what} in one line, without control characters and lone surrogates, got "
            f"{text!a}. Rename it."
        )


@contextmanager
def explained(expected: str, fix: str = "", kind: type[UserError] = UserError) -> Iterator[None]:
    """Turn what a user's code or file raises in this block into a `UserError`.

    Args:
        expected: What was expected, such as `Expected the environment to be reset`.
        fix: How to fix it, a sentence.
        kind: The error's class. A `UserError` is raised as it is.
    """
    try:
        yield
    except (UserError, WorkerError):  # such as a server that is gone
        raise
    except Exception as error:  # a user's code may raise anything
        message = f"{expected}, got {described(error)}. {fix}"
        raise kind(message.rstrip()) from error


def described(error: BaseException) -> str:
    """Write an exception in a line: its type and its message, or the line of code without one.

    Addresses of objects are left out, so that the same error reads the same in every process.
    """
    name = type(error).__name__
    try:
        told = str(error).strip()
    except Exception:  # whatever a user's __str__ may raise
        told = ""
    if "Traceback" in told:  # TorchScript's, for example: its last line says what is wrong
        told = told.splitlines()[-1].removeprefix(f"{name}: ")
    message = plain(" ".join(told.split())).rstrip(".")
    if not message:
        place = traceback.extract_tb(error.__traceback__)[-1:]
        where = [f" at {PurePath(at.filename).name}:{at.lineno} ({at.line})" for at in place]
        return f"{name} without a message{''.join(where)}"
    text = f"{name}: {_ADDRESS.sub('0x...', message)}"
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def broken_world(
    what: str,
    error: BaseException,
    expected: str,
    fix: str = "Narrow the ranges to worlds that it takes.",
) -> InvalidWorld:
    """Return the error of a world in which `what`, such as `a step`, raised an exception."""
    told = described(error)
    return InvalidWorld(f"{expected}, got {told}. {fix}".rstrip(), f"{what} raised {told}")
