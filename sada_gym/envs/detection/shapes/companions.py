"""The files that a mesh file names, such as its textures: found beside it, never outside."""

from __future__ import annotations

import hashlib
import posixpath
import warnings
import zipfile
from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from sada_gym.envs.detection.shapes.surface import MAX_TEXTURE
from sada_gym.errors import UserError
from sada_gym.foundations.files import read_file, shown

Texture = npt.NDArray[np.uint8]

MAX_BYTES = 2**30
"""Size of one file, which is read into memory."""


class Companions:
    """The files that one mesh file may name, by their paths relative to a folder or an archive.

    Exporters write paths of their own machine and of other systems: letters count in either case,
    backslashes are slashes, and what is not found by its path is looked for by its name, in the
    mesh file's folder and then in the folder `textures`.
    """

    def __init__(
        self,
        member: str,
        locate: Callable[[str], str | None],
        read: Callable[[str], bytes],
        textures: str | None = None,
    ) -> None:
        self.member = member
        self.sha256 = hashlib.sha256()
        """Of all files that were read, one after another."""
        self._folders = [posixpath.dirname(member), *([] if textures is None else [textures])]
        self._locate = locate
        self._read = read
        self._textures: dict[str, Texture] = {}

    @classmethod
    def in_archive(cls, archive: zipfile.ZipFile, member: str) -> Companions:
        """Take the files of a ZIP."""
        names = {name.lower(): name for name in archive.namelist()}
        return cls(member, lambda path: names.get(path.lower()), partial(_unpacked, archive))

    @classmethod
    def in_folder(cls, folder: Path, member: str, textures: str | None = None) -> Companions:
        """Take the files below a folder, but for those that links bring there."""
        root = folder.resolve()
        return cls(
            member,
            partial(_located, root),
            lambda name: read_file(root / name, MAX_BYTES),
            textures,
        )

    def own(self) -> bytes:
        """Read the mesh file itself."""
        return self._noted(self.member)

    def find(self, name: str) -> str | None:
        """Find the file that the mesh file names so; None if it does not lie beside it."""
        path = name.strip().strip('"').replace("\\", "/").lower()
        places = [
            posixpath.normpath(posixpath.join(folder, place))
            for folder in self._folders
            for place in (path, posixpath.basename(path))
        ]
        return next(filter(None, map(self._locate, places)), None)

    def read(self, name: str) -> bytes:
        """Read a file that the mesh file names; raise `UserError` if it does not lie beside it."""
        found = self.find(name)
        if found is None:
            raise UserError(f"no file {shown(name)!r} beside it, which it names: add that file")
        return self._noted(found)

    def texture(self, name: str) -> Texture:
        """Read a picture, (h, w, 4), at most `MAX_TEXTURE` a side; the same one only once."""
        if name not in self._textures:
            self._textures[name] = decode_texture(self.read(name), name)
        return self._textures[name]

    def _noted(self, name: str) -> bytes:
        content = self._read(name)
        self.sha256.update(content)
        return content


def decode_texture(content: bytes, name: str) -> Texture:
    """Decode a picture as (h, w, 4), sRGB and alpha, at most `MAX_TEXTURE` a side."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            picture = Image.open(BytesIO(content))
        scale = MAX_TEXTURE / max(picture.size)
        rgba = picture.convert("RGBA")
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise UserError(
            f"a texture {shown(name)!r} of more than {Image.MAX_IMAGE_PIXELS:,} pixels: reduce it "
            f"to {MAX_TEXTURE:,} a side"
        ) from error
    # Pillow raises whatever the broken bytes lead it to.
    except Exception as error:
        raise UserError(f"a texture {shown(name)!r} that cannot be decoded ({error})") from error
    if scale < 1:
        width, height = (max(1, round(side * scale)) for side in rgba.size)
        rgba = rgba.resize((width, height), Image.Resampling.BOX)
    return np.asarray(rgba)


def _located(root: Path, path: str) -> str | None:
    """Find a file below a folder, with letters in either case; None if there is none."""
    found = root
    for part in path.split("/"):
        inside = {entry.name.lower(): entry for entry in found.iterdir()} if found.is_dir() else {}
        exact = found / part
        match = exact if exact in inside.values() else inside.get(part.lower())
        if match is None:
            return None
        found = match
    if not found.is_file() or not found.resolve().is_relative_to(root):
        return None
    return found.relative_to(root).as_posix()


def _unpacked(archive: zipfile.ZipFile, name: str) -> bytes:
    if name not in archive.namelist():
        raise UserError(f"an archive without {shown(name)}")
    if archive.getinfo(name).file_size > MAX_BYTES:  # zipfile unpacks no more than is announced
        raise UserError(f"a file {shown(name)!r} of more than {MAX_BYTES // 2**20:,} MB")
    try:
        return archive.read(name)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError) as error:
        raise UserError(f"a file {shown(name)!r} that cannot be unpacked ({error})") from error
