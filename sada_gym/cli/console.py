"""What the commands share: the two consoles, tables, options, and errors as sentences."""

from __future__ import annotations

import errno
import json
import os
import shlex
import shutil
import signal
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TextIO

import typer
from pydantic_core import to_jsonable_python
from rich.console import Console
from rich.segment import Segment
from rich.table import Table

from sada_gym.errors import BudgetExhausted, Notice, UserError, WorkerError, is_plain, plain


class PlainConsole(Console):
    """Escapes what a terminal would obey in texts that others wrote, such as an agent's error."""

    def render(self, *args: Any, **kwargs: Any) -> Iterator[Segment]:
        """Render as ever, but for such characters."""
        for segment in super().render(*args, **kwargs):
            is_safe = segment.control or is_plain(segment.text)
            yield segment if is_safe else Segment(_visible(segment.text), segment.style)


def _visible(text: str) -> str:
    return "\n".join(map(plain, text.split("\n")))


out = PlainConsole()
err = PlainConsole(stderr=True)

_debug = False
_document: TextIO = sys.stdout


def option(
    default: Any,
    text: str,
    *names: str,
    metavar: str | None = None,
    minimum: int | None = None,
    shown: str | bool = True,
) -> Any:
    """Declare an option of a command: `...` is the default of a required one.

    Without `names` it is named as the parameter. The help shows the default, or `shown` instead.
    """
    return typer.Option(
        default, *names, help=text, metavar=metavar, min=minimum, show_default=shown
    )


def env_kwargs_option() -> Any:
    """Declare `--env-kwargs`."""
    text = "A keyword of the environment, such as object_class=car; repeatable."
    return option(None, text, "--env-kwargs", metavar="k=v")


def workers_option(default: int | None, shown: str | bool = True) -> Any:
    """Declare `--workers`."""
    text = "The number of processes; the result does not depend on it."
    return option(default, text, "--workers", minimum=1, shown=shown)


def run_argument() -> Any:
    """Declare the argument RUN."""
    return typer.Argument(metavar="RUN", help="The folder that `sada-gym attack` wrote.")


def application_option(run: str = "a run") -> Any:
    """Declare `--application`."""
    text = f"What was attacked, if {run} did not record it."
    return option(None, text, metavar="ID|FILE.toml", shown="what RUN names")


def executor_option() -> Any:
    """Declare `--executor`."""
    text = "`processes`, `dask` (a local cluster), or `dask:ADDRESS` of a scheduler."
    return option("processes", text, "--executor", metavar="NAME")


def json_option(what: str = "the result") -> Any:
    """Declare `--json`, which prints one JSON document on stdout instead of all else."""
    text = f"Print {what} as JSON, and nothing else."
    return typer.Option(False, "--json", help=text, callback=_keep_stdout_clean)


def print_json(document: Any) -> None:
    """Print a JSON document: a pydantic model, a dataclass, or what they are made of.

    The option of `json_option` is given. The text is ASCII: any pipe takes it as it is.
    """
    print(json.dumps(to_jsonable_python(document), indent=2, allow_nan=False), file=_document)


def _keep_stdout_clean(context: typer.Context, wanted: bool) -> bool:
    """Send to stderr what users' code, workers and libraries print, if JSON is wanted."""
    global _document
    before = sys.stdout
    if not wanted or before is None:  # a closed stdout gets nothing
        return wanted
    _document = before
    before.flush()
    real = sys.__stdout__
    if before is real and real is not None:  # its descriptor, too: workers and C write there
        kept = os.fdopen(os.dup(real.fileno()), "w", encoding="ascii")
        os.dup2(sys.stderr.fileno(), real.fileno())
        context.call_on_close(lambda: _give_back(kept, real))
        _document = kept
    sys.stdout = sys.stderr
    context.call_on_close(lambda: setattr(sys, "stdout", before))
    return True


def _give_back(kept: TextIO, real: TextIO) -> None:
    with suppress(BrokenPipeError):  # the reader has had enough
        kept.flush()
    os.dup2(kept.fileno(), real.fileno())
    kept.close()


def set_debug(on: bool) -> None:
    """Choose whether errors keep their tracebacks."""
    global _debug
    _debug = on


@contextmanager
def errors_as_sentences() -> Iterator[None]:
    """Turn bad input into one sentence and exit code 2, a lost worker into exit code 1.

    Any other exception is a bug and keeps its traceback.
    """
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            yield
    except (UserError, BudgetExhausted, WorkerError, OSError) as error:
        is_long = isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG
        if _debug or (isinstance(error, OSError) and not is_long):
            raise
        told = "Expected names of files that the system takes, got one that is too long."
        say(told if is_long else str(error), lead="[bold red]Error:[/] ", console=err)
        raise typer.Exit(1 if isinstance(error, WorkerError) else 2) from error


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,  # noqa: ARG001
    line: str | None = None,  # noqa: ARG001
) -> None:
    if issubclass(category, Notice):
        say(str(message), console=err)
    else:
        text = warnings.formatwarning(_visible(str(message)), category, filename, lineno)
        sys.stderr.write(text)


def say(text: str, *, lead: str = "", console: Console = out) -> None:
    """Print a paragraph that breaks between words only; in a pipe it is one line.

    `lead` goes before the text and may hold Rich's markup; the text is printed as it is.
    """
    line = console.render_str(lead, markup=True, highlight=False).append(text)
    # without crop and overflow a word that is longer than a line, such as a path, stays whole
    soft = not console.is_terminal
    console.print(line, highlight=False, soft_wrap=soft, overflow="ignore", crop=False)


def make_table(*columns: str, title: str | None = None, left: int | None = None) -> Table:
    """Make a table of which the first columns, by default all, are aligned on the left."""
    table = Table(title=title, header_style="bold", title_justify="left")
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if left is None or i < left else "right")
    return table


class Terminated(KeyboardInterrupt):
    """SIGTERM: a container or a queue stops the command."""


@contextmanager
def stoppable() -> Iterator[None]:
    """Let SIGTERM stop this block as Ctrl-C does, so that it cleans up and says how to go on."""

    def stop(number: int, frame: object) -> None:  # noqa: ARG001
        raise Terminated

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def stop_code(error: KeyboardInterrupt) -> int:
    """Return the exit code of a command that was stopped: 128 and the signal's number."""
    return 128 + (signal.SIGTERM if isinstance(error, Terminated) else signal.SIGINT)


def show_resume_hint(kept: str, *more: str) -> None:
    """Print after a stop what is kept, and the command line, with `more`, that goes on."""
    called, *given = sys.argv
    is_on_path = shutil.which("sada-gym") is not None or os.path.basename(called) != "sada-gym"
    words = ["sada-gym" if is_on_path else called, *given]
    command = shlex.join(words + [option for option in more if option not in given])
    say(f"\nStopped. {kept}", console=err)
    say("Continue with:", console=err)
    err.print(f"  {command}", markup=False, highlight=False, soft_wrap=True)


@contextmanager
def scores_progress(*, kept: bool = True) -> Iterator[Callable[[int, int, int], None]]:
    """Show how many scores there are; Ctrl-C exits with code 130.

    If the scores are `kept`, it says how to go on.
    """
    from sada_gym.experiment.algorithm import RunProgress
    from sada_gym.experiment.progress import AttackProgress

    done = 0
    try:
        with AttackProgress(err) as progress:

            def show(count: int, total: int, cached: int) -> None:
                nonlocal done
                done = count
                progress(RunProgress("test", count, total, cached, count - cached))

            yield show
    except KeyboardInterrupt:
        if kept:
            show_resume_hint(f"{done:,} scores are saved.")
        else:
            say("\nStopped. No score was saved; --store FILE saves them.", console=err)
        raise typer.Exit(130) from None


def check_no_stray_words(words: Sequence[str], example: str) -> None:
    """Refuse words that belong to no option, such as the second of `--set a=1 b=2`."""
    if words:
        raise UserError(
            f"Expected an option before each value, got {words[0]!r} without one. "
            f"Write an option again for each further value: {example}."
        )


def wrapped(text: str, indent: int) -> str:
    """Break a text between words to the width of the terminal, with so many spaces before it."""
    start = " " * indent
    whole = text.replace(" %", "\N{NO-BREAK SPACE}%")
    lines = textwrap.fill(whole, out.width, initial_indent=start, subsequent_indent=start,
                          break_long_words=False, break_on_hyphens=False)  # fmt: skip
    return lines.replace("\N{NO-BREAK SPACE}", " ")


def key_values(pairs: Sequence[str] | None, option: str) -> dict[str, Any]:
    """Parse `k=v` pairs; a value is JSON where it parses as such, else a string."""
    parsed: dict[str, Any] = {}
    for pair in pairs or ():
        key, equals, text = pair.partition("=")
        if not key or not equals:
            raise UserError(f"Expected {option} key=value, got {pair!r}.")
        if key in parsed:
            raise UserError(f"Expected each key of {option} once, got {key!r} twice.")
        try:
            parsed[key] = json.loads(text)
        except (ValueError, RecursionError):
            parsed[key] = text
    return parsed


def cores() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # counts what a container or a queue grants
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
