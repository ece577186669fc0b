"""What an entry is put together from: runs, and the results of other entries."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from sada_gym import agents
from sada_gym.cards import find_card
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.record import (
    RESULT_FILE,
    SAMPLES_FILE,
    SETTINGS_FILE,
    RunReport,
    RunSettings,
    differences,
    read_samples,
)
from sada_gym.files import read_model
from sada_gym.submission.checks import check_entry
from sada_gym.submission.entry import ABOUT_FILE, CLAIMS, read_entry, write_result
from sada_gym.submission.models import MAX_SEEDS, Identity, Result, SeedResult
from sada_gym.submission.today import (
    PAPER_BUDGETS,
    RULES,
    board_tracks,
    find_target,
    is_ours,
    today,
)


@dataclass(frozen=True, eq=False)
class Part:
    """Some seeds of one result.

    Attributes:
        source: Where they are from, for messages.
        identity: What the result is of.
        seeds: The claims.
        samples: The samples of each seed that has measures.
        command: The command that made it; empty where that is not known.
    """

    source: str
    identity: Identity
    seeds: tuple[SeedResult, ...]
    samples: Mapping[int, Evaluations]
    command: str = ""


@dataclass(eq=False)
class Results:
    """The results of one adversary, put together from parts."""

    parts: dict[str, list[Part]] = field(default_factory=dict)

    @property
    def first(self) -> Part:
        """The first part."""
        return next(iter(self.parts.values()))[0]

    def add(self, part: Part) -> None:
        """Add a part.

        Raises:
            UserError: If it is of another adversary, or of another result of the same name, or has
                a seed that is there already.
        """
        if self.parts:
            refuse_other_adversary(part, self.first.identity, self.first.source)
        known = self.parts.setdefault(part.identity.stem, [])
        for other in known:
            changes = differences(
                other.identity.model_dump(mode="json"), part.identity.model_dump(mode="json")
            )
            if changes:
                raise UserError(
                    f"Expected {part.source} to differ from {other.source} in its seed alone, got "
                    f"other settings: {'; '.join(changes)}. Submit them as two entries."
                )
            twice = {one.seed for one in other.seeds} & {one.seed for one in part.seeds}
            if twice:
                raise UserError(
                    f"Expected each seed of {part.identity.stem} once, got {min(twice)} in both "
                    f"{other.source} and {part.source}. Name one of them, or attack with another "
                    "--seed."
                )
        known.append(part)

    def write(self, folder: Path) -> None:
        """Write all results."""
        for parts in self.parts.values():
            seeds = [seed for part in parts for seed in part.seeds]
            samples = {seed: one for part in parts for seed, one in part.samples.items()}
            write_result(folder, _make_result(parts[0].identity, seeds), samples)


def read_run(folder: Path, rule: str | None) -> list[Part]:
    """Read the folder of an attack, or of an entry.

    Args:
        folder: The folder.
        rule: The rule for the budget; None takes `paper-budgets`, or all that an entry has.

    Raises:
        UserError: If it is neither, or cannot take part.
    """
    if (folder / ABOUT_FILE).exists():
        return _read_entry(folder, rule)
    if (folder / RESULT_FILE).exists():
        return [_read_attack(folder, rule or PAPER_BUDGETS)]
    if (folder / SETTINGS_FILE).exists():
        raise UserError(
            f"Expected a finished run, got {folder}, which was stopped. Go on with it by "
            "sada-gym attack --resume."
        )
    raise UserError(
        f"Expected the folder of a run, with {RESULT_FILE}, or of an entry, with {ABOUT_FILE}; got "
        f"{folder}, which holds neither. A benchmark's entries are in its folder `entries`."
    )


def _read_entry(folder: Path, rule: str | None) -> list[Part]:
    check_entry(folder, submission=False)
    entry = read_entry(folder)
    parts = [
        Part(
            f"{folder / stem}{CLAIMS}",
            one.claimed.identity,
            one.claimed.seeds,
            one.samples,
            entry.about.command,
        )
        for stem, one in entry.results.items()
        if rule in (None, one.claimed.identity.rule)
    ]
    if not parts:
        raise UserError(
            f"Expected results by the rule {rule} in {folder}, got others. Leave --rule out to "
            "take all of them."
        )
    return parts


def _read_attack(folder: Path, rule: str) -> Part:
    report = read_model(folder / RESULT_FILE, RunReport)
    samples, settings = read_samples(folder / SAMPLES_FILE), report.settings
    track = _board_track(folder, settings)
    identity = today(
        track,
        settings.agent,
        rule,
        settings.adversary,
        settings.preset,
        settings.options,
        resolved=settings.resolved,
    )
    made = Identity.of(settings, rule, report.fooling_threshold)
    free = {"track": track, "budget": identity.budget}  # checked apart
    changes = differences(
        made.model_copy(update=free).model_dump(mode="json"), identity.model_dump(mode="json")
    )
    if changes:
        raise UserError(
            f"Expected the run in {folder} to be of {track} as the leaderboard has it today, but: "
            f"{'; '.join(changes)}. Attack again with these settings."
        )
    refuse_budget(f"the run in {folder}", settings.budget, identity, "--budget")
    seed = SeedResult.of(report)
    command = _command(settings, track)
    return Part(str(folder), identity, (seed,), {seed.seed: samples}, command)


def _board_track(folder: Path, settings: RunSettings) -> str:
    """Find the track that a run was made on, which may have been named by a general id."""
    if settings.track in board_tracks():
        return settings.track
    card = find_card(settings.application)
    if card is None or not card.track_ids:
        raise UserError(
            f"Expected a run on a track of the leaderboard, got one on {settings.track} in "
            f"{folder}. Environments of one's own cannot take part: the verifier has to evaluate "
            "the samples again, and nobody else could compare. `sada-gym envs` lists the tracks."
        )
    if settings.agent in agents.names(card.name):
        for track in card.track_ids:
            there = find_target(track, settings.agent).settings
            if there.application_settings == settings.application_settings:
                return track
    raise UserError(
        f"Expected a run on a track of the leaderboard with a shipped agent, got one on "
        f"{settings.track} against {settings.agent} in {folder}, with other settings. Attack one "
        f"of {', '.join(card.track_ids)}."
    )


def refuse_budget(what: str, budget: int, identity: Identity, option: str) -> None:
    """Refuse a budget above that of the identity's rule, and say what the rules allow."""
    if budget <= identity.budget:
        return
    allowed = {
        rule: today(
            identity.track,
            identity.agent,
            rule,
            identity.adversary,
            identity.preset,
            identity.options,
            resolved=identity.resolved,
        ).budget
        for rule in RULES
    }
    listed = " and ".join(f"{allowed[rule]:,} by the rule {rule}" for rule in RULES)
    raise UserError(
        f"Expected {what} to have a budget of at most {identity.budget:,} queries, got {budget:,}. "
        f"{identity.adversary} may spend {listed} on {identity.track}: choose another --rule, or "
        f"attack again with fewer queries ({option})."
    )


def _make_result(identity: Identity, seeds: Sequence[SeedResult]) -> Result:
    if len(seeds) > MAX_SEEDS:
        raise UserError(
            f"Expected at most {MAX_SEEDS} seeds of {identity.stem}, got {len(seeds)}. Submit the "
            "first ones."
        )
    return Result.make(identity, seeds)


def refuse_other_adversary(part: Part, known: Identity, source: str) -> None:
    """Refuse a part of another adversary, preset or options than those of an identity."""
    for name in ("adversary", "preset", "options"):
        expected, got = getattr(known, name), getattr(part.identity, name)
        if expected != got:
            raise UserError(
                "Expected all results of an entry to be of one adversary with one set of options, "
                f"got the {name} {got!r} in {part.source} beside {expected!r} in {source}. Submit "
                "them as two entries."
            )


def _command(settings: RunSettings, track: str) -> str:
    """Give the command that made a run, without its folder; empty for a class without a name."""
    known = is_ours(settings.adversary) or ":" in settings.adversary
    words = ["sada-gym", "attack", track, "--adversary", settings.adversary]
    if settings.preset is not None:
        words += ["--preset", settings.preset]
    for name, value in settings.options.items():
        words += ["--set", f"{name}={json.dumps(value)}"]
    words += ["--agent", settings.agent] if settings.agent else []
    words += ["--budget", str(settings.budget), "--seed", str(settings.seed)]
    command = shlex.join(words)
    return command if known and len(command) <= 1_000 else ""
