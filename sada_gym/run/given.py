"""How what a run attacks was given, so that it can be opened again."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal
from urllib.parse import unquote_to_bytes

from typing_extensions import Self

from sada_gym.application import Application
from sada_gym.errors import FileError
from sada_gym.foundations.files import MAX_TOML_BYTES, Strict, parse_toml, read_file
from sada_gym.foundations.ids import names_file

_SCHEME = "file://"


class Given(Strict):
    """The environment as it was given to `attack`, so that `Run.open` can make it again.

    Attributes:
        by: `id` (by the environment's id), `toml` (by the text of the TOML file), or `python` (only
            the program that made the application, or a keyword of the id, can make it again).
        id: The environment's id; empty without one.
        keywords: The keywords of the id; None without an id, and in runs made before 0.1.0, where
            they follow from the application's settings.
        toml: The text of the TOML file; empty in runs made before 0.1.0: they have only its path.
        file: The path of the TOML file, as a `file:` URI; paths in it start there.
    """

    by: Literal["id", "toml", "python"]
    id: str = ""
    keywords: dict[str, Any] | None = None
    toml: str = ""
    file: str = ""

    @classmethod
    def of(cls, environment: str | Application, keywords: Mapping[str, Any]) -> Self:
        """Record the environment that is passed to `attack`."""
        if isinstance(environment, Application):
            return cls(by="python")
        if names_file(environment):
            return cls.of_file(Path(environment))
        try:
            plain = json.loads(json.dumps(dict(keywords), allow_nan=False, default=os.fspath))
        except (TypeError, ValueError):  # an agent, say, that lives in this program alone
            return cls(by="python", id=environment)
        return cls(by="id", id=environment, keywords=plain)

    @classmethod
    def of_file(cls, path: Path) -> Self:
        """Record a TOML file."""
        text = read_file(path, MAX_TOML_BYTES).decode("utf-8-sig", errors="replace")
        return cls(by="toml", toml=text, file=path.absolute().as_uri())

    @property
    def path(self) -> Path:
        """The path of the TOML file."""
        return Path(os.fsdecode(unquote_to_bytes(self.file.removeprefix(_SCHEME))))

    @property
    def agent(self) -> str:
        """The agent's name or file as it was given; empty without one, or if made in Python."""
        given: Any = (self.keywords or {}).get("agent", "")
        with suppress(FileError):
            given = parse_toml(self.toml.encode(), self.path).get("agent", given)
        return given if isinstance(given, str) else ""

    def environment(self) -> str | Application:
        """Return the id, the path of the TOML file if it is unchanged, or the application.

        Raises:
            UserError: If the text of the file no longer describes an application.
        """
        if self.by != "toml":
            return self.id
        if not self.toml or (self.path.is_file() and self.of_file(self.path).toml == self.toml):
            return str(self.path)
        from sada_gym.envs.wrapped.toml import application_of, find_modules_in

        find_modules_in(self.path.parent)
        return application_of(parse_toml(self.toml.encode(), self.path), self.path)
