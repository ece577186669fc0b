"""An agent that can be fetched from a package of two small files, and how it is read."""

from __future__ import annotations

import hashlib
import io
import tarfile
from pathlib import Path

import pytest

from sada_gym.foundations.cards import FetchedAgent

FILES = {"package/models/toy.json": b'{"k": 1}', "package/models/toy.bin": b"weights" * 99}


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def convert(members: dict[str, bytes]) -> bytes:
    """Join the files."""
    return b"".join(content for _, content in sorted(members.items()))


def load(path: Path) -> tuple[str, bytes]:
    """Load an agent that is nothing but its file's content."""
    return "toy", path.read_bytes()


TOY = FetchedAgent(
    name="toy-net",
    client="npm",
    package="@toys/net",
    version="1.2.3",
    archive="toys-net-1.2.3.tgz",
    members={name: sha256(content) for name, content in FILES.items()},
    converter="toy_fetch:convert",
    loader="toy_fetch:load",
    sha256=sha256(convert(FILES)),
    summary="a toy",
    nominal="plays",
    licence="MIT",
    megabytes=1,
)


def pack(path: Path, files: dict[str, bytes]) -> Path:
    """Write files as npm packs them."""
    with tarfile.open(path, "w:gz") as archive:
        for name, content in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))
    return path


def offer(monkeypatch: pytest.MonkeyPatch, agent: FetchedAgent = TOY) -> None:
    """Let the toy be what can be fetched for every application."""
    for module in ("sada_gym.foundations.cards", "sada_gym.foundations.fetch", "sada_gym.agents"):
        monkeypatch.setattr(f"{module}.fetchable", lambda application=None: {agent.name: agent})
