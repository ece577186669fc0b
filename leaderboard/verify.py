"""Verifies entries of the leaderboard: `python -m leaderboard.verify ENTRY... --nonce TEXT`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from sada_gym.cli.console import errors_as_sentences, option, say, workers_option

if TYPE_CHECKING:
    from sada_gym.board.submission.verification import Verdict

app = typer.Typer(
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def verify(
    entries: list[Path] = typer.Argument(metavar="ENTRY...", help="The folders of the entries."),
    nonce: str | None = option(
        None,
        "A text that no submitter could know; it makes the evaluation seeds fresh.",
        metavar="TEXT",
        shown="none; with --check, the one in each file",
    ),
    workers: int = workers_option(1),
    again: bool = option(
        False, "Evaluate again the results that were verified with this nonce.", "--again"
    ),
    missing: bool = option(False, "Skip results that were verified with any nonce.", "--missing"),
    check: bool = option(False, "Write nothing; compare with the existing files.", "--check"),
    against: Path | None = option(
        None,
        "The folder of the entries to look for equal samples in.",
        metavar="DIR",
        shown="the folder of each entry",
    ),
) -> None:
    """Score the samples of entries again on fresh seeds, and write the findings beside the claims.

    The exit code is 1 if an entry was refused, or if --check finds a difference from the files.
    """
    failed = False
    with errors_as_sentences():
        from sada_gym.board.submission.verification import verify as verify_entries

        verdicts = verify_entries(
            entries,
            nonce,
            workers=workers,
            again=again,
            missing=missing,
            check=check,
            against=against,
        )
        for verdict in verdicts:
            failed |= verdict.state in {"refused", "differs"}
            _show(verdict)
    if failed:
        raise typer.Exit(1)


def _show(verdict: Verdict) -> None:
    where = " ".join(part for part in (verdict.entry, verdict.place) if part)
    verified = verdict.verified
    says = {
        "verified": "verified",
        "unchanged": "verified before, and unchanged",
        "outdated": f"outdated, so it was not evaluated: {verdict.reason}",
        "differs": f"differs: {verdict.reason}",
        "refused": f"refused: {verdict.reason}",
    }
    bad = verdict.state in {"refused", "differs"}
    say(f"{where}: {says[verdict.state]}", lead="[bold red]" if bad else "")
    if verified is None:
        return
    for seed in verified.seeds:
        measures = seed.measures
        low, high = measures.afr_interval_95
        covered = measures.relative_coverage
        coverage = "no coverage" if covered is None else f"coverage {100 * covered:.1f} %"
        rate = f"AFR {100 * measures.afr:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
        say(f"  seed {seed.seed}: {rate}, {coverage}")
    for name, sentence in verified.flags.items():
        say(f"{name}: {sentence}.", lead="  [yellow]")


if __name__ == "__main__":
    app(prog_name="python -m leaderboard.verify")
