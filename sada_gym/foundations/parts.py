"""Exchangeable parts, such as adversaries and renderers, found by a name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sada_gym.errors import MissingExtra, UserError, check_known, described
from sada_gym.foundations.lazy import load


def find_part(kind: str, name: str, table: Mapping[str, str]) -> Any:
    """Import a part by its name in a table of `module:attribute`, or by a path of that form.

    `kind` is what the part is called in messages, such as `renderer`.

    Raises:
        UserError: If there is no such part, or its module cannot be imported.
    """
    if ":" not in name:
        check_known(kind, [name], list(table))
    path = table.get(name, name)
    try:
        return load(path)
    except MissingExtra:
        raise
    except (ModuleNotFoundError, AttributeError) as error:
        article = "an" if kind[0] in "aeiou" else "a"
        raise UserError(
            f"Expected {article} {kind}'s name or module:Class, got {name!r} ({error}). Install "
            "the module, or set PYTHONPATH to the folder that holds it."
        ) from error
    except (Exception, SystemExit) as error:  # whatever a user's module may raise
        if path != name:
            raise  # one of ours: a bug
        raise UserError(
            f"Expected to import {name.partition(':')[0]!r} for the {kind} {name!r}, but the "
            f"module raised {described(error)}. Fix the module."
        ) from error
