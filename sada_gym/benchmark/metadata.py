"""What the entries that a benchmark makes say of themselves."""

from __future__ import annotations

import shlex

from pydantic import ValidationError

from sada_gym.benchmark.suite import ADVERSARIES
from sada_gym.errors import UserError
from sada_gym.experiment.adversary import AdversarySpec, json_compatible
from sada_gym.files import first_error
from sada_gym.results.models import EntryMetadata, entry_name

AUTHORS, LICENCE = ("sada_gym's developers",), "MIT"
"""Who made the entries of our own adversaries, and the licence of their data."""


def metadata_of(label: str, adversary: AdversarySpec) -> EntryMetadata:
    """Write down what the entry of an adversary says of itself.

    Raises:
        UserError: If its label gives no name for a folder, or its options are no JSON.
    """
    ours = ADVERSARIES.get(label) == adversary
    try:
        json_compatible(adversary.options)
        return EntryMetadata(
            name=entry_name(label),
            title=label,
            authors=AUTHORS if ours else (),
            licence=LICENCE if ours else "",
            command=shlex.join(["sada-gym", "benchmark", "-a", label]) if ours else "",
        )
    except (ValidationError, UserError) as error:
        reason = first_error(error) if isinstance(error, ValidationError) else str(error)
        raise UserError(
            f"Expected an adversary that an entry can describe, got {label!r} ({reason}). Give it "
            "a short label, and options that can be written as JSON."
        ) from error
