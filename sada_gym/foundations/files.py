"""Writes files whole or not at all, and checks files that it reads."""

from __future__ import annotations

import codecs
import errno
import io
import json
import math
import os
import re
import shutil
import stat
import struct
import sys
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from sada_gym.errors import FileError, UserError, UserTypeError, is_plain, plain

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_TOML_BYTES = 2**20
MAX_JSON_BYTES = 256 * 2**20
MAX_ARRAYS_BYTES = 2**30
"""Larger files are refused unread; this package writes far smaller ones."""

_REASONS = {
    errno.ENOENT: "there is no such file or folder. Check its path",
    errno.ENOTDIR: "a part of its path is a file, not a folder. Check its path",
    errno.EISDIR: "it is a folder. Name a file",
    errno.EEXIST: "something of that name is already there. Remove it, or name another place",
    errno.EACCES: "this user may not. Change its permissions, or name another place",
    errno.EPERM: "this user may not. Change its permissions, or name another place",
    errno.EROFS: "its file system is read-only. Name a place that can be written to",
    errno.ENOSPC: "the disk is full. Free some space and try again",
    errno.EDQUOT: "the disk quota is used up. Free some space and try again",
    errno.EFBIG: "it would be larger than the system allows. Raise that limit",
    errno.EIO: "the disk reported an error. Try another disk",
    errno.ELOOP: "its path is a loop of links. Name another place",
    errno.ENAMETOOLONG: "its name is too long. Name another place",
}
_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, struct.error, ValueError, SyntaxError, EOFError),
    *(RuntimeError, OSError, OverflowError, TypeError, LookupError, MemoryError),
    tokenize.TokenError,
)
"""The errors that zipfile and NumPy raise for damaged content."""

_MAX_SHOWN = 300
_ESCAPES = re.compile(r"\\\\|\\ud[89ab]..\\ud[c-f]..|(\\ud[89a-f])")
"""A backslash in JSON, a pair of surrogates, or, as group 1, the beginning of a lone one."""

_OF_THE_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG, errno.EIO}


class Strict(BaseModel):
    """A frozen model without unknown fields, whose numbers are finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


Model = TypeVar("Model", bound=Strict)


def _printable(text: str) -> str:
    if not is_plain(text):
        raise ValueError(f"expected text in one line, got control characters in {text!r}")
    return text


OneLine = Annotated[str, AfterValidator(_printable)]
"""Text from a file that can be shown in a terminal: no line breaks, no control characters."""


def as_path(given: Any, what: str) -> Path:
    """Return a user's path of `what`; raise `UserTypeError` if it is none, or empty."""
    if not isinstance(given, str | os.PathLike) or given == "":
        raise UserTypeError(f"Expected the path of {what}, got {given!r}.")
    return Path(given)


@contextmanager
def file_errors(what: str, path: Path) -> Iterator[None]:
    """Turn the system's errors on a file or folder into a `FileError` with a clear message.

    `what` names the attempt: `with file_errors("read", path): content = path.read_bytes()`.
    """
    try:
        yield
    except OSError as error:
        reason = _REASONS.get(error.errno or 0, f"{error.strerror or error}. Name another place")
        raise FileError(f"Expected to {what} {path}, but {reason}.") from error
    except UserError:
        raise
    except ValueError as error:
        if not path.name:
            raise FileError(f"Expected to {what} a file, got {str(path)!r}. Name one.") from error
        if not isinstance(error, UnicodeEncodeError) and "\0" not in str(path):
            raise
        raise FileError(
            f"Expected to {what} {str(path)!r}, but its name holds a NUL or half a character. Name "
            "another place."
        ) from error


def write_file(path: Path, content: bytes | str) -> None:
    """Write a file beside its place, then rename it: all of it or nothing (`FileError`).

    A text is written as UTF-8. Lone surrogates, as in names of files that are not UTF-8, are
    escaped.
    """
    if isinstance(content, str):
        content = content.encode(errors="backslashreplace")
    with file_errors("write", path):
        beside = _place_beside(path)
        # a link that somebody put there since would be refused, not followed
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)
        descriptor = os.open(beside, flags | getattr(os, "O_BINARY", 0), 0o666)
        try:
            with open(descriptor, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
        except OSError:
            beside.unlink(missing_ok=True)
            raise


def write_folder(path: Path, fill: Callable[[Path], None]) -> None:
    """Fill an empty folder, and put it in the place of an earlier run's; or raise `FileError`."""
    with file_errors("write the folder", path):
        beside = _place_beside(path)
        beside.mkdir()
    try:
        fill(beside)
        sync(beside)
    except OSError as error:
        if error.errno not in _OF_THE_DISK:
            raise  # a mistake of the caller's
        with file_errors("write the folder", path):
            raise
    with file_errors("write the folder", path):
        old = _place_beside(path, "old")
        if path.is_symlink() or path.is_file():
            path.unlink()
        elif path.exists():
            path.rename(old)
        beside.rename(path)
        shutil.rmtree(old, ignore_errors=True)


def sync(folder: Path) -> None:
    """Make sure that a folder's files are on the disk: after a loss of power none is empty."""
    for file in folder.rglob("*"):
        if file.is_file():
            with file.open("rb+") as written:
                os.fsync(written.fileno())


def restore_folder(path: Path) -> None:
    """Put a folder back that `write_folder` had moved away when its process was killed."""
    old = path.with_name(f".{path.name}.old")
    if old.is_dir() and not old.is_symlink() and not path.exists() and not path.is_symlink():
        with file_errors("restore the folder", path):
            old.rename(path)


def _place_beside(path: Path, ending: str = "tmp") -> Path:
    """Name a temporary place beside another, and clear what a killed run left there."""
    beside = path.with_name(f".{path.name}.{ending}")
    if beside.is_dir() and not beside.is_symlink():
        shutil.rmtree(beside)
    else:
        beside.unlink(missing_ok=True)  # removes a link, never what it points to
    return beside


def write_model(path: Path, model: Strict) -> None:
    """Write a model as JSON; raise `FileError` if it cannot be written."""
    text = json.dumps(model.model_dump(mode="json"), indent=2, allow_nan=False)
    if "\\ud" in text:  # readers refuse a lone surrogate
        text = _ESCAPES.sub(lambda found: f"\\{found[0]}" if found[1] else found[0], text)
    write_file(path, f"{text}\n")


def read_model(path: Path, kind: type[Model]) -> Model:
    """Read a model that `write_model` wrote; raise `FileError` for anything else."""
    content = read_file(path, MAX_JSON_BYTES).removeprefix(codecs.BOM_UTF8)
    cause: Exception
    try:
        content.decode()
        return kind.model_validate_json(content, strict=True)
    except UnicodeDecodeError as error:
        reason, cause = f"byte {error.start} is not UTF-8", error
    except ValidationError as error:
        reason, cause = first_error(error), error
    raise FileError(
        f"Expected {path} as sada-gym writes it, got a different one ({reason}). "
        "Restore it, or start again in another folder."
    ) from cause


def first_error(error: ValidationError, whole: str = "the file") -> str:
    """Say in a few words what the content of a model, such as `whole`, lacks, and where."""
    first = error.errors()[0]
    where = ".".join(map(str, first["loc"])) or whole
    return shown(f"{where}: {first['msg']}")


def shown(text: str) -> str:
    """Cut a text from a file for a message, and escape what a terminal would obey."""
    escaped = plain(text)
    return escaped if len(escaped) <= _MAX_SHOWN else f"{escaped[:_MAX_SHOWN]}..."


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; raise `FileError` if it cannot be read, is too large or no TOML."""
    return parse_toml(read_file(path, MAX_TOML_BYTES), path)


def parse_toml(content: bytes, path: Path) -> dict[str, Any]:
    """Parse the content of a TOML file; messages name `path`. A `FileError` if it is no TOML."""
    try:
        return tomllib.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # a decoding error is a ValueError too
        raise FileError(
            f"Expected a TOML file in {path}, got something else: {error}. Fix that place; "
            "https://toml.io shows how TOML is written."
        ) from error


def read_file(path: Path, max_bytes: int) -> bytes:
    """Read a regular file of at most so many bytes; raise `FileError` if it is anything else."""
    with file_errors("read", path):
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, "")
        if not stat.S_ISREG(status.st_mode):  # a pipe would never end
            raise FileError(f"Expected a regular file in {path}, got a pipe, socket or device.")
        if status.st_size > max_bytes:
            raise FileError(
                f"Expected {path} to be at most {max_bytes >> 20:,} MiB, got "
                f"{status.st_size >> 20:,} MiB. Restore the file, or name another."
            )
        return path.read_bytes()


def read_arrays(
    path: Path,
    kinds: Mapping[str, tuple[str, int]],
    *,
    optional: Mapping[str, tuple[str, int]] | None = None,
) -> dict[str, npt.NDArray[Any]]:
    """Read named arrays of an NPZ file; nothing in it is ever unpickled.

    `kinds` has the dtype and the number of dimensions of each, and `optional` those of arrays that
    may be missing. It raises `FileError` if the file cannot be read, or does not hold exactly such
    arrays.
    """
    with _npz(path, f"the arrays {_listed(kinds)}") as (archive, names):
        kinds = {
            **kinds,
            **{name: kind for name, kind in (optional or {}).items() if name in names},
        }
        if names != sorted(kinds):
            raise _UnfitError(f"arrays named {', '.join(names) or 'nothing'}")
        return {name: _read_array(archive, name, *kind) for name, kind in kinds.items()}


def read_array_groups(
    path: Path, kinds: Mapping[str, tuple[str, int]]
) -> dict[str, dict[str, npt.NDArray[Any]]]:
    """Read groups of arrays, named GROUP.KIND, of an NPZ file, as `read_arrays` reads arrays."""
    with _npz(path, f"groups GROUP.KIND of the arrays {_listed(kinds)}") as (archive, names):
        groups = sorted({name.rpartition(".")[0] for name in names})
        if names != sorted(f"{group}.{kind}" for group in groups for kind in kinds):
            raise _UnfitError(f"arrays named {', '.join(names)}")
        return {
            group: {
                kind: _read_array(archive, f"{group}.{kind}", *form) for kind, form in kinds.items()
            }
            for group in groups
        }


def _listed(kinds: Mapping[str, tuple[str, int]]) -> str:
    return ", ".join(f"{name} ({dtype}, {n}-d)" for name, (dtype, n) in kinds.items())


@contextmanager
def _npz(path: Path, wanted: str) -> Iterator[tuple[zipfile.ZipFile, list[str]]]:
    content = read_file(path, MAX_ARRAYS_BYTES)
    fix = "Restore the file, or make it again."
    with (
        _content_errors(f"an NPZ file with {wanted} in {path}", "it is damaged", fix),
        zipfile.ZipFile(io.BytesIO(content)) as archive,
    ):
        yield archive, sorted(name.removesuffix(".npy") for name in archive.namelist())


def read_array(path: Path, max_bytes: int) -> npt.NDArray[Any]:
    """Read the array of an NPY file; nothing in it is ever unpickled.

    It raises `FileError` if the file cannot be read, is larger than `max_bytes`, or holds none.
    """
    content = read_file(path, max_bytes)
    damage = "it is damaged, or of another kind"
    with _content_errors(f"an NPY file of numbers in {path}", damage, "Write it by numpy.save."):
        return _parse_array(content, "an array")


@contextmanager
def _content_errors(expected: str, damage: str, fix: str) -> Iterator[None]:
    try:
        yield
        return
    except _UnfitError as error:
        reason, cause = shown(str(error)), cast(Exception, error)
    except _DAMAGE as error:
        reason, cause = damage, error
    raise FileError(f"Expected {expected}, got something else ({reason}). {fix}") from cause


class _UnfitError(Exception):
    """The message says what an NPZ file holds instead of the expected arrays."""


def _read_array(archive: zipfile.ZipFile, name: str, dtype: str, ndim: int) -> npt.NDArray[Any]:
    # a small file may decompress to gigabytes, whatever size it names; `numpy.savez` does not
    if archive.getinfo(f"{name}.npy").compress_type != zipfile.ZIP_STORED:
        raise _UnfitError(f"{name} is compressed")
    array = _parse_array(archive.read(f"{name}.npy"), name)
    if array.dtype != np.dtype(dtype) or array.ndim != ndim:
        raise _UnfitError(f"{name} of dtype {array.dtype} and shape {array.shape}")
    return array


def _parse_array(content: bytes, name: str) -> npt.NDArray[Any]:
    buffer = io.BytesIO(content)
    version = np.lib.format.read_magic(buffer)
    if version != (1, 0):
        raise _UnfitError(f"{name} of NPY version {version}")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(buffer)
    if dtype.hasobject:
        raise _UnfitError(f"{name} of dtype {dtype}")
    data = buffer.read()
    # checked before it is allocated: a header may claim any shape
    if min(shape, default=0) < 0 or len(data) != math.prod(shape) * dtype.itemsize:
        raise _UnfitError(f"{name} of shape {shape} in {len(data)} bytes")
    array = np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if fortran else "C")
    return array.copy()
