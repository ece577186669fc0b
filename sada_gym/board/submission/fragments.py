"""What an entry is put together from: runs, and the results of other entries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from sada_gym import agents
from sada_gym.board.results.entry import METADATA_FILE, EntryResult, read_entry
from sada_gym.board.results.models import MAX_SEEDS, Result, SeedResult
from sada_gym.board.submission.checks import check_entry, check_same_adversary
from sada_gym.board.submission.current import (
    PAPER_BUDGETS,
    RULES,
    board_tracks,
    current_experiment,
    current_target,
)
from sada_gym.board.submission.files import refuse
from sada_gym.errors import UserError
from sada_gym.experiment.differences import differences
from sada_gym.experiment.record import Experiment, RunReport
from sada_gym.experiment.target import Target
from sada_gym.foundations.cards import find_card
from sada_gym.foundations.files import first_error, read_model, shown
from sada_gym.run.command import attack_command
from sada_gym.run.folder import RESULT_FILE, SAMPLES_FILE, SETTINGS_FILE, read_samples

_LONGEST_COMMAND = 1_000


@dataclass(frozen=True, eq=False)
class ResultFragment:
    """Some seeds of one result, where they are from, and the command that made them, if known."""

    source: str
    result: EntryResult
    command: str = ""


def join_fragments(fragments: Sequence[ResultFragment]) -> list[EntryResult]:
    """Join the fragments of each result.

    Raises:
        UserError: If they are of several adversaries, or of several experiments in one place, or a
            seed stands twice, or a result has too many seeds.
    """
    by_place: dict[str, list[ResultFragment]] = {}
    of_seed: dict[tuple[str, int], ResultFragment] = {}
    first = fragments[0]
    for fragment in fragments:
        adversary, place = fragment.result.experiment.adversary, fragment.result.place
        check_same_adversary(
            fragment.source, adversary, first.source, first.result.experiment.adversary
        )
        by_place.setdefault(place, []).append(fragment)
        other = by_place[place][0]
        if fragment.result.experiment != other.result.experiment:
            changes = differences(
                other.result.experiment.model_dump(), fragment.result.experiment.model_dump()
            )
            raise UserError(
                f"Expected {fragment.source} to differ from {other.source} in its seed alone, got "
                f"other settings: {shown('; '.join(changes))}. Submit them as two entries."
            )
        for claims in fragment.result.claimed.seeds:
            other = of_seed.setdefault((place, claims.seed), fragment)
            if other is not fragment:
                raise UserError(
                    f"Expected each seed of {place} once, got {claims.seed} in both "
                    f"{other.source} and {fragment.source}. Name one of them, or attack with "
                    "another --seed."
                )
    return [_join(place, parts) for place, parts in by_place.items()]


def _join(place: str, fragments: Sequence[ResultFragment]) -> EntryResult:
    results = [fragment.result for fragment in fragments]
    seeds = [claims for result in results for claims in result.claimed.seeds]
    if len(seeds) > MAX_SEEDS:
        refuse(f"of {place}", f"at most {MAX_SEEDS} seeds", len(seeds), "Submit the first ones")
    samples = {seed: rows for result in results for seed, rows in result.samples.items()}
    claimed = Result.make(fragments[0].result.experiment, seeds)
    return EntryResult(claimed, dict(sorted(samples.items())))


def read_fragments(folder: Path, rule: str | None) -> list[ResultFragment]:
    """Read the folder of an attack, or of an entry; a UserError if it cannot take part.

    Without a rule it takes `paper-budgets` for an attack, and all that an entry has.
    """
    if (folder / METADATA_FILE).exists():
        return _read_entry(folder, rule)
    if (folder / RESULT_FILE).exists():
        return [_read_attack(folder, rule or PAPER_BUDGETS)]
    if (folder / SETTINGS_FILE).exists():
        raise UserError(
            f"Expected a finished run, got {folder}. Finish it by sada-gym attack --resume."
        )
    raise UserError(
        f"Expected the folder of a run, with {RESULT_FILE}, or of an entry, with {METADATA_FILE}; "
        f"got {folder}, which holds neither. A benchmark's entries are in its folder `entries`."
    )


def _read_entry(folder: Path, rule: str | None) -> list[ResultFragment]:
    check_entry(folder, submission=False)
    entry = read_entry(folder)
    fragments = [
        ResultFragment(f"{folder}: {place}", result, entry.metadata.command)
        for place, result in entry.results.items()
        if rule in (None, result.experiment.protocol.rule)
    ]
    if not fragments:
        raise UserError(
            f"Expected results by the rule {rule} in {folder}, got others. Leave --rule out to "
            "take all of them."
        )
    return fragments


def _read_attack(folder: Path, rule: str) -> ResultFragment:
    report = read_model(folder / RESULT_FILE, RunReport)
    samples, run = read_samples(folder / SAMPLES_FILE), report.settings.experiment
    track = _board_track(folder, run.target)
    current = current_experiment(track, run.target.agent, rule, run.adversary)
    # the budget is checked apart, and the run may bear a general id
    attacked = run.model_copy(
        update={
            "target": run.target.model_copy(update={"track": track}),
            "protocol": current.protocol.model_copy(update={"samples": run.protocol.samples}),
        }
    )
    changes = differences(attacked.at(None).model_dump(), current.model_dump())
    if changes:
        raise UserError(
            f"Expected the run in {folder} to be of {track} as the leaderboard has it today, but: "
            f"{shown('; '.join(changes))}. Attack again with these settings."
        )
    check_budget(f"the run in {folder}", run.protocol.budget, current, "--budget")
    try:
        claims = SeedResult.of(report)
    except ValidationError as error:
        reason = first_error(error)
        raise UserError(f"Expected an entry to be able to hold {folder}, but {reason}.") from error
    result = EntryResult(Result.make(current, [claims]), {claims.seed: samples})
    command = attack_command(report.settings, track, agent=run.target.agent)
    return ResultFragment(str(folder), result, command if len(command) <= _LONGEST_COMMAND else "")


def _board_track(folder: Path, target: Target) -> str:
    if target.track in board_tracks():
        return target.track
    card = find_card(target.application.name)
    if card is None or not card.track_ids:
        raise UserError(
            f"Expected a run on a track of the leaderboard, got one on {target.track} in "
            f"{folder}. Your own environments cannot take part: the verifier has to evaluate "
            "the samples again, and nobody else could compare. `sada-gym envs` lists the tracks."
        )
    if target.agent in agents.names(card.name):
        for track in card.track_ids:
            if current_target(track, target.agent).target.application == target.application:
                return track
    raise UserError(
        f"Expected a run on a track of the leaderboard with a shipped agent, got one on "
        f"{target.track} against {target.agent} in {folder}, with other settings. Attack one "
        f"of {', '.join(card.track_ids)}."
    )


def check_budget(what: str, budget: int, experiment: Experiment, option: str) -> None:
    """Raise a UserError if a budget is above an experiment's; it says what the rules allow."""
    target, adversary, protocol = experiment.target, experiment.adversary, experiment.protocol
    if budget <= protocol.budget:
        return
    rules = [current_experiment(target.track, target.agent, rule, adversary) for rule in RULES]
    protocols = [experiment.protocol for experiment in rules]
    listed = " and ".join(f"{p.budget:,} by the rule {p.rule}" for p in protocols)
    raise UserError(
        f"Expected {what} to have a budget of at most {protocol.budget:,} queries, got {budget:,}. "
        f"{adversary.name} may spend {listed} on {target.track}: choose another --rule, or attack "
        f"again with fewer queries ({option})."
    )
