"""`sada-gym submit`: makes an entry of the leaderboard, and checks it."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from sada_gym.cli.console import (
    err,
    errors_as_sentences,
    json_option,
    option,
    out,
    print_json,
    say,
    workers_option,
)
from sada_gym.errors import UserError

if TYPE_CHECKING:
    from rich.console import Console

    from sada_gym.board.results.entry import Entry, EntryResult
    from sada_gym.board.results.models import EntryMetadata


def submit(
    name: str = option(..., "The entry's name: small letters, digits and -+._"),
    authors: list[str] = option(..., "An author; repeatable."),
    licence: str = option(..., "The licence of the data, such as CC-BY-4.0."),
    runs: list[Path] | None = typer.Argument(
        None,
        metavar="RUN",
        help="Folders of `sada-gym attack`, of several seeds and tracks, or entries that a "
        "benchmark made (DIR/entries/NAME).",
    ),
    title: str = option("", "What the board calls it.", metavar="TEXT", shown="the name"),
    description: str = option(
        "", "What the adversary does, in a sentence.", metavar="TEXT", shown=False
    ),
    paper: str = option("", "The address of a paper.", metavar="URL", shown=False),
    repository: str = option("", "The address of the code.", metavar="URL", shown=False),
    command: str = option(
        "", "How the results are made.", metavar="TEXT", shown="the first run's command"
    ),
    rule: str | None = option(
        None,
        "The rule for the budget: `paper-budgets` or `equal-queries`.",
        metavar="NAME",
        shown="paper-budgets; of an entry, all that it has",
    ),
    samples: list[Path] | None = option(
        None,
        "Instead of runs: an NPY file of M samples, (M, d) in [-1, 1]; one for each seed.",
        metavar="FILE",
    ),
    track: str | None = option(None, "The environment of the samples.", metavar="ID"),
    agent: str | None = option(
        None, "The agent that they fool.", metavar="NAME", shown="the track's first"
    ),
    queries: int | None = option(None, "The training queries that each seed spent.", minimum=0),
    adversary: str | None = option(
        None, "What you call the adversary that found them.", metavar="NAME"
    ),
    options: str | None = option(
        None, "The adversary's options, as a JSON object.", metavar="JSON"
    ),
    workers: int = workers_option(1),
    out_folder: Path = option(
        Path("leaderboard/entries"), "The folder of the entries.", "--out", metavar="DIR"
    ),
    replace: bool = option(False, "Replace results that the entry already has.", "--replace"),
    as_json: bool = json_option("the entry"),
) -> None:
    """Make an entry of the leaderboard from runs or from your own samples, and check it.

    Nothing is uploaded. The entry is a folder of data, which you commit and propose by a pull
    request. An existing entry of that name receives the new results.
    """
    with errors_as_sentences():
        from sada_gym.board.submission.submit import make_metadata
        from sada_gym.board.submission.submit import submit as submit_runs

        metadata = make_metadata(
            name=name,
            authors=authors,
            licence=licence,
            title=title,
            description=description,
            date=time.strftime("%Y-%m-%d", time.gmtime()),
            paper=paper,
            repository=repository,
            command=command,
        )
        where: dict[str, Any] = {"out": out_folder, "replace": replace}
        every: dict[str, Any] = {
            **{"track": track, "agent": agent, "queries": queries},
            **{"adversary": adversary, "options": options},
        }
        own = {name: value for name, value in every.items() if value is not None}
        if samples and runs:
            raise UserError(
                f"Expected runs or --samples, got both: {runs[0]} and {samples[0]}. Submit "
                "one after the other, under the same --name."
            )
        if samples:
            missing = [f"--{name}" for name in ("track", "queries", "adversary") if name not in own]
            if missing:
                raise UserError(
                    f"Expected {' and '.join(missing)} beside --samples, got none. Say where the "
                    "samples belong, and what they cost."
                )
            own |= {"options": _parse_options(options or "{}"), "workers": workers, **where}
            own |= {} if rule is None else {"rule": rule}
            entry = _submit_samples(samples, metadata, err if as_json else out, **own)
        elif own:
            raise UserError(
                f"Expected --{next(iter(own))} only with --samples, got it without. A run knows "
                "its own."
            )
        else:
            entry = submit_runs(runs or [], metadata, rule=rule, **where)
    if as_json:
        claims = {place: result.claimed for place, result in sorted(entry.results.items())}
        print_json({"folder": entry.folder, "metadata": entry.metadata, "results": claims})
    else:
        _show(entry)


def _submit_samples(
    samples: list[Path], metadata: EntryMetadata, console: Console, *, track: str, **keywords: Any
) -> Entry:
    from sada_gym.board.submission.current import current_target
    from sada_gym.board.submission.submit import submit_samples
    from sada_gym.experiment.progress import AttackProgress

    target = current_target(track, keywords.get("agent"))
    ideal = "" if target.ideal_set is None else " and as many ideal ones"
    each = f"{len(samples)} x {target.sample_size:,} samples{ideal}"
    say(f"Evaluating {each} on {track}, each once.", console=console)
    with AttackProgress(console) as progress:
        return submit_samples(samples, metadata, track=track, on_progress=progress, **keywords)


def _parse_options(text: str) -> dict[str, Any]:
    try:
        options = json.loads(text)
    except (ValueError, RecursionError):
        options = None
    if not isinstance(options, dict):
        raise UserError(
            f'Expected options that are a JSON object, such as {{"trials": 1000}}, got {text!r}.'
        )
    return options


def _show(entry: Entry) -> None:
    say(f"{entry.metadata.title} · {entry.folder}", lead="[bold]")
    for place, result in sorted(entry.results.items()):
        say(f"  {place}: {_summary(result)}")
    say(f"The entry passes all checks. Commit the folder {entry.folder} and open a pull request.")
    say("The verifier will evaluate its samples again, on seeds that nobody knows yet.")


def _summary(result: EntryResult) -> str:
    import numpy as np

    from sada_gym.measures.rates import attack_fooling_rate

    claims = result.claimed
    seeds = "1 seed" if len(claims.seeds) == 1 else f"{len(claims.seeds)} seeds"
    if not result.samples:
        return f"no samples, {seeds}"
    scores = np.concatenate([samples.score for samples in result.samples.values()])
    rate = attack_fooling_rate(scores, claims.experiment.target.fooling_threshold)
    measured = [claim.measures for claim in claims.seeds if claim.measures is not None]
    shares = [m.relative_coverage for m in measured if m.relative_coverage is not None]
    coverage = f"coverage {100 * sum(shares) / len(shares):.1f} %" if shares else "no coverage"
    return f"AFR {rate}, {coverage}, {seeds}"
