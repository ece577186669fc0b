"""The key of a score in an evaluation store, besides mu and seed."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from typing_extensions import Self

from sada_gym.application import Application
from sada_gym.errors import StoreError, UserTypeError, check_plain
from sada_gym.evaluation.sources import own_sources
from sada_gym.foundations.files import Strict


class ApplicationKey(Strict):
    """Everything that decides a score besides mu and seed.

    Attributes:
        name: The application's name.
        version: The application's version.
        settings: Its resolved keywords. For your own application or environment, they include a
            hash of its code.
        fingerprint: The SHA-256 of the agent and of whatever else decides the score; for your own
            agent, it includes the agent's code.
    """

    name: str
    version: int
    settings: dict[str, Any]
    fingerprint: str

    @classmethod
    def of(cls, application: Application) -> Self:
        """Make the key of an application.

        Raises:
            StoreError: If the application has no fingerprint.
            TypeError: If its settings are not JSON-compatible.
        """
        kind = type(application).__name__
        name, version, fingerprint = application.name, application.version, application.fingerprint
        if not isinstance(name, str) or not isinstance(version, int) or abs(version) >= 2**63:
            raise UserTypeError(
                f"Expected name to be a text and version an int in {kind}, got {name!r} and "
                f"{version!r}. Set them in the class."
            )
        check_plain(f"name of {kind}", name)
        check_plain(f"agent_name of {kind}", application.agent_name)
        if fingerprint is not None and not isinstance(fingerprint, str):
            raise UserTypeError(
                f"Expected the fingerprint of {name} to be a text or None, got {fingerprint!r}."
            )
        if fingerprint is None:
            raise StoreError(application._without_fingerprint)
        try:
            settings = json.loads(json.dumps(application.settings, allow_nan=False))
        except (TypeError, ValueError) as error:
            raise UserTypeError(
                f"Expected JSON-compatible settings from {kind}.settings, got "
                f"{application.settings!r} ({error}). Return numbers, strings, lists, None."
            ) from error
        if sources := own_sources(application._own_code):
            settings["source_sha256"] = sources
        if sources := own_sources([] if application.agent is None else [application.agent]):
            text = json.dumps([fingerprint, sources])
            fingerprint = hashlib.sha256(text.encode()).hexdigest()
        return cls(name=name, version=version, settings=settings, fingerprint=fingerprint)

    @property
    def settings_json(self) -> str:
        """The settings as canonical JSON."""
        return json.dumps(self.settings, sort_keys=True, separators=(",", ":"), allow_nan=False)
