"""Checks an entry's files before they are read: their names, kinds and sizes, and strict JSON."""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import stat
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from sada_gym.board.results.entry import CLAIMS, METADATA_FILE, SAMPLES, VERIFIED
from sada_gym.errors import FileError, UserError
from sada_gym.foundations.files import file_errors, read_file, shown

MAX_FILES = 100  #: The most files of an entry.
MAX_BYTES = {METADATA_FILE: 2**16, CLAIMS: 2**24, SAMPLES: 2**26, VERIFIED: 2**24}
"""The most bytes of entry.toml, of the JSON of results, of their samples, and of findings."""

MAX_ENTRY_BYTES = 2**27  #: The most bytes of all files of an entry.

_STEM = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,150}")
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?")  # no file of Windows


def refuse(where: str, expected: str, got: object, fix: str = "Make the entry again") -> NoReturn:
    """Raise a UserError that says what was expected, where, what came, and how to fix it."""
    raise UserError(f"Expected {expected} {where}, got {got}. {fix}.")


def check_files(folder: Path, *, submission: bool) -> list[str]:
    """Check names, kinds and sizes of an entry's files, and return the names of its groups."""
    where = f"in {folder}"
    with file_errors("read", folder):
        name = folder.absolute().name
        if not _STEM.fullmatch(name) or _RESERVED.fullmatch(name):
            allowed = "to be named by small letters, digits and - + . _"
            refuse(allowed, "an entry's folder", shown(repr(name)), "Rename it")
        if folder.is_symlink() or not stat.S_ISDIR(folder.lstat().st_mode):
            raise UserError(f"Expected the folder of an entry, got {folder}, which is no folder.")
        with os.scandir(folder) as listed:
            files = list(itertools.islice(listed, MAX_FILES + 1))
        if len(files) > MAX_FILES:
            refuse(where, f"at most {MAX_FILES:,} files", "more", "Submit fewer results")
        sizes = {file.name: _measure_file(folder, file, submission) for file in files}
    if METADATA_FILE not in sizes:
        refuse(where, METADATA_FILE, "none", "Make an entry by sada-gym submit")
    limit, total = MAX_ENTRY_BYTES >> 20, sum(sizes.values())
    if total > MAX_ENTRY_BYTES:
        refuse(where, f"at most {limit} MiB", f"{total >> 20} MiB", "Submit fewer results")
    return _check_pairs(folder, sizes)


def _measure_file(folder: Path, file: os.DirEntry[str], submission: bool) -> int:
    path, ending = folder / file.name, _ending(file.name)
    if ending is None:
        only = f"only {METADATA_FILE} and results"
        refuse(f"in {folder}", only, shown(repr(file.name)), "Remove it")
    status, limit = file.stat(follow_symlinks=False), MAX_BYTES[ending]
    if not stat.S_ISREG(status.st_mode):
        got, fix = "a link, a folder or a device", "Put the file itself there"
        refuse(f"in {path}", "a regular file", got, fix)
    if submission and ending == VERIFIED:
        fix = "Remove it; the verifier writes such files"
        refuse("in a submission", "no results of the verifier", path, fix)
    if status.st_size > limit:
        refuse(f"in {path}", f"at most {limit:,} bytes", f"{status.st_size:,}")
    return status.st_size


def _ending(name: str) -> str | None:
    if name == METADATA_FILE:
        return METADATA_FILE
    for ending in (VERIFIED, CLAIMS, SAMPLES):
        if name.endswith(ending) and _STEM.fullmatch(name.removesuffix(ending)):
            return ending
    return None


def _check_pairs(folder: Path, names: Iterable[str]) -> list[str]:
    endings: dict[str, set[str]] = {}
    for name in names:
        if (ending := _ending(name)) not in (None, METADATA_FILE):
            endings.setdefault(name.removesuffix(ending), set()).add(ending)
    if not set().union(*endings.values()) & {CLAIMS, SAMPLES}:
        refuse(f"in {folder}", "at least one result", "none")
    for stem, present in sorted(endings.items()):
        for ending in (CLAIMS, SAMPLES):
            if ending not in present:
                beside, fix = f"beside {stem}{min(present)}", "Add it, or remove the other file"
                refuse(f"in {folder}", f"{stem}{ending} {beside}", "none", fix)
    return sorted(endings)


def check_strict_json(path: Path, max_bytes: int) -> None:
    """Raise a FileError for JSON that other programs may read differently, or that is none.

    It may hold a key twice, or a number that is infinite or beyond 64 bits.
    """
    content = read_file(path, max_bytes)
    cause: Exception
    try:
        json.loads(
            content.decode(),
            object_pairs_hook=_check_keys,
            parse_constant=_finite,
            parse_float=_finite,
            parse_int=_bounded,
        )
        return
    except UnicodeDecodeError as error:
        expected, got, cause = "UTF-8", f"something else at byte {error.start}", error
    except RecursionError as error:
        expected, got, cause = "plain JSON", "one nested too deeply", error
    except ValueError as error:
        expected, got, cause = "plain JSON", f"something else: {shown(str(error))}", error
    raise FileError(f"Expected {expected} in {path}, got {got}. Make the entry again.") from cause


def _check_keys(pairs: Sequence[tuple[str, Any]]) -> None:
    keys = set()
    for key, _ in pairs:
        if key in keys:
            raise ValueError(f"the key {key!r} twice")
        keys.add(key)


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text}, which is not a finite number")
    return number


def _bounded(text: str) -> int:
    if len(text) > 20 or abs(int(text)) >= 2**63:
        raise ValueError("a whole number beyond 64 bits")
    return int(text)
