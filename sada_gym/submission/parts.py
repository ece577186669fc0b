"""What an entry is put together from: runs, and the results of other entries."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from sada_gym import agents
from sada_gym.cards import find_card
from sada_gym.errors import UserError
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.differences import differences
from sada_gym.experiment.folder import RESULT_FILE, SAMPLES_FILE, SETTINGS_FILE, read_samples
from sada_gym.experiment.record import Experiment, RunReport, RunSettings
from sada_gym.experiment.target import Target
from sada_gym.files import read_model
from sada_gym.results.entry import METADATA_FILE, EntryResult, read_entry
from sada_gym.results.models import MAX_SEEDS, Result, SeedResult
from sada_gym.submission.checks import check_entry
from sada_gym.submission.current import (
    PAPER_BUDGETS,
    RULES,
    board_tracks,
    current_experiment,
    current_target,
)


@dataclass(frozen=True, eq=False)
class Part:
    """Some seeds of one result.

    Attributes:
        source: Where they are from, for messages.
        result: The claims and the samples.
        command: The command that made it; empty where that is not known.
    """

    source: str
    result: EntryResult
    command: str = ""

    @property
    def experiment(self) -> Experiment:
        """What the result is of."""
        return self.result.claimed.experiment


@dataclass(eq=False)
class Parts:
    """The results of one adversary, put together from parts."""

    by_place: dict[str, list[Part]] = field(default_factory=dict)

    @property
    def first(self) -> Part:
        """The first part."""
        return next(iter(self.by_place.values()))[0]

    def add(self, part: Part) -> None:
        """Add a part.

        Raises:
            UserError: If it is of another adversary, or of another result in the same place, or has
                a seed that is there already.
        """
        if self.by_place:
            check_same_adversary(part, self.first.experiment.adversary, self.first.source)
        known = self.by_place.setdefault(part.result.place, [])
        for other in known:
            changes = differences(other.experiment.model_dump(), part.experiment.model_dump())
            if changes:
                raise UserError(
                    f"Expected {part.source} to differ from {other.source} in its seed alone, got "
                    f"other settings: {'; '.join(changes)}. Submit them as two entries."
                )
            seeds, others = (
                {claims.seed for claims in each.result.claimed.seeds} for each in (part, other)
            )
            if seeds & others:
                raise UserError(
                    f"Expected each seed of {part.result.place} once, got {min(seeds & others)} in "
                    f"both {other.source} and {part.source}. Name one of them, or attack with "
                    "another --seed."
                )
        known.append(part)

    def results(self) -> Iterator[EntryResult]:
        """Join the parts of each result.

        Raises:
            UserError: If a result has too many seeds.
        """
        for place, parts in self.by_place.items():
            seeds = [claims for part in parts for claims in part.result.claimed.seeds]
            if len(seeds) > MAX_SEEDS:
                raise UserError(
                    f"Expected at most {MAX_SEEDS} seeds of {place}, got {len(seeds)}. Submit the "
                    "first ones."
                )
            samples = {seed: held for part in parts for seed, held in part.result.samples.items()}
            yield EntryResult(Result.make(parts[0].experiment, seeds), samples)


def read_run(folder: Path, rule: str | None) -> list[Part]:
    """Read the folder of an attack, or of an entry.

    Args:
        folder: The folder.
        rule: The rule for the budget; None takes `paper-budgets`, or all that an entry has.

    Raises:
        UserError: If it is neither, or cannot take part.
    """
    if (folder / METADATA_FILE).exists():
        return _read_entry(folder, rule)
    if (folder / RESULT_FILE).exists():
        return [_read_attack(folder, rule or PAPER_BUDGETS)]
    if (folder / SETTINGS_FILE).exists():
        raise UserError(
            f"Expected a finished run, got {folder}, which was stopped. Go on with it by "
            "sada-gym attack --resume."
        )
    raise UserError(
        f"Expected the folder of a run, with {RESULT_FILE}, or of an entry, with {METADATA_FILE}; "
        f"got {folder}, which holds neither. A benchmark's entries are in its folder `entries`."
    )


def _read_entry(folder: Path, rule: str | None) -> list[Part]:
    check_entry(folder, submission=False)
    entry = read_entry(folder)
    parts = [
        Part(f"{folder}: {place}", result, entry.metadata.command)
        for place, result in entry.results.items()
        if rule in (None, result.claimed.experiment.protocol.rule)
    ]
    if not parts:
        raise UserError(
            f"Expected results by the rule {rule} in {folder}, got others. Leave --rule out to "
            "take all of them."
        )
    return parts


def _read_attack(folder: Path, rule: str) -> Part:
    report = read_model(folder / RESULT_FILE, RunReport)
    samples, run = read_samples(folder / SAMPLES_FILE), report.settings.experiment
    track = _board_track(folder, run.target)
    current = current_experiment(track, run.target.agent, rule, run.adversary)
    # the budget is checked apart
    target = run.target.model_copy(update={"track": track})
    protocol = current.protocol.model_copy(update={"samples": run.protocol.samples})
    made = Experiment(target=target, adversary=run.adversary, protocol=protocol)
    changes = differences(made.model_dump(), current.model_dump())
    if changes:
        raise UserError(
            f"Expected the run in {folder} to be of {track} as the leaderboard has it today, but: "
            f"{'; '.join(changes)}. Attack again with these settings."
        )
    check_budget(f"the run in {folder}", run.protocol.budget, current, "--budget")
    claims = SeedResult.of(report)
    result = EntryResult(Result.make(current, [claims]), {claims.seed: samples})
    return Part(str(folder), result, _command(report.settings, track))


def _board_track(folder: Path, target: Target) -> str:
    """Find the track that a run was made on, which may have been named by a general id."""
    if target.track in board_tracks():
        return target.track
    card = find_card(target.application.name)
    if card is None or not card.track_ids:
        raise UserError(
            f"Expected a run on a track of the leaderboard, got one on {target.track} in "
            f"{folder}. Environments of one's own cannot take part: the verifier has to evaluate "
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
    """Refuse a budget above that of an experiment, and say what the rules allow.

    Raises:
        UserError: If it is above.
    """
    target, adversary, protocol = experiment.target, experiment.adversary, experiment.protocol
    if budget <= protocol.budget:
        return
    allowed = {
        rule: current_experiment(target.track, target.agent, rule, adversary).protocol.budget
        for rule in RULES
    }
    listed = " and ".join(f"{allowed[rule]:,} by the rule {rule}" for rule in RULES)
    raise UserError(
        f"Expected {what} to have a budget of at most {protocol.budget:,} queries, got {budget:,}. "
        f"{adversary.name} may spend {listed} on {target.track}: choose another --rule, or attack "
        f"again with fewer queries ({option})."
    )


def check_same_adversary(part: Part, known: AdversarySpec, source: str) -> None:
    """Refuse a part of another adversary, preset or options.

    Raises:
        UserError: If one of them differs.
    """
    adversary = part.experiment.adversary
    for name in ("name", "preset", "options"):
        expected, got = getattr(known, name), getattr(adversary, name)
        if expected != got:
            raise UserError(
                "Expected all results of an entry to be of one adversary with one set of options, "
                f"got the {name} {got!r} in {part.source} beside {expected!r} in {source}. Submit "
                "them as two entries."
            )


def _command(settings: RunSettings, track: str) -> str:
    """Write the command that made a run, without its folder; empty for a class without a name."""
    experiment = settings.experiment
    adversary = experiment.adversary
    words = ["sada-gym", "attack", track, "--adversary", adversary.name]
    if adversary.preset is not None:
        words += ["--preset", adversary.preset]
    for name, value in adversary.options.items():
        words += ["--set", f"{name}={json.dumps(value)}"]
    words += ["--agent", experiment.target.agent] if experiment.target.agent else []
    words += ["--budget", str(experiment.protocol.budget), "--seed", str(settings.seed)]
    command = shlex.join(words)
    known = adversary.is_ours or ":" in adversary.name
    return command if known and len(command) <= 1_000 else ""
