"""The outer parts of glTF 2.0: its container, what it requires, and the arrays in its buffers."""

from __future__ import annotations

import base64
import binascii
import json
import struct
import urllib.parse
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.shapes.companions import Companions
from sada_gym.errors import UserError
from sada_gym.foundations.files import shown

Json = Mapping[str, Any]

_READ = frozenset(
    {"KHR_mesh_quantization", "EXT_mesh_gpu_instancing", "KHR_node_visibility"}
    | {"KHR_texture_transform", "EXT_texture_webp", "KHR_lights_punctual", "KHR_xmp_json_ld"}
    | {"KHR_animation_pointer", "KHR_node_hoverability", "KHR_node_selectability"}
)
"""Extensions that are read, or that change nothing that is drawn."""

_OF_PICTURES = ("KHR_texture_basisu", "EXT_texture_avif", "MSFT_texture_dds")
_COMPRESSED = {
    "KHR_draco_mesh_compression": "Draco compression",
    "EXT_meshopt_compression": "meshopt compression",
    "KHR_meshopt_compression": "meshopt compression",
}
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class GltfFile:
    """A glTF file's JSON, and the arrays that it names."""

    def __init__(self, content: bytes, companions: Companions | None) -> None:
        self._binary, self.json = b"", _json(content)
        if content.startswith(b"glTF"):
            self.json, self._binary = _chunks(content)
        self.companions = companions
        self._buffers: dict[int, bytes] = {}
        asset = self.json.get("asset", {})
        version = str(asset.get("minVersion", asset.get("version", "2.0")))
        if version != "2.0":
            raise UserError(f"glTF {shown(version)}, where 2.0 is read: export it as glTF 2.0")
        for name in self.json.get("extensionsRequired", []):
            if name in _COMPRESSED:
                raise UserError(f"{_COMPRESSED[name]} ({name}): export it without compression")
            looks = name.startswith("KHR_materials_") or (
                companions is None and name in _OF_PICTURES
            )
            if name not in _READ and not looks:
                raise UserError(f"the required extension {shown(name)}, which is not read here")

    def items(self, kind: str) -> list[Any]:
        """Return a list of the file, such as `nodes`; empty where there is none."""
        items: list[Any] = self.json.get(kind, [])
        return items

    def item(self, kind: str, index: int) -> Any:
        """Return one thing of a list, such as a node."""
        items = self.items(kind)
        if not isinstance(index, int) or not 0 <= index < len(items):
            raise UserError(f"a reference to number {index!r} of {len(items)} {kind}")
        return items[index]

    def array(self, index: int) -> npt.NDArray[Any]:
        """Return an accessor's values, (count, width); normalised integers become floats."""
        accessor = self.item("accessors", index)
        dtype, width = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        count = accessor["count"]
        if "bufferView" in accessor:
            offset = accessor.get("byteOffset", 0)
            values = self._strided(accessor["bufferView"], offset, dtype, count, width)
        elif count * width > 2**28:
            raise UserError(f"an array of {count:,} items that no buffer holds")
        else:
            values = np.zeros((count, width), dtype)
        sparse = accessor.get("sparse")
        if sparse:
            places, changed = sparse["indices"], sparse["values"]
            kind = np.dtype(_TYPES[places["componentType"]])
            rows = self._strided(
                places["bufferView"], places.get("byteOffset", 0), kind, sparse["count"], 1
            )
            values = values.copy()
            if rows.size and rows.max() >= count:
                raise UserError("a sparse array that changes items beyond its end")
            values[rows[:, 0]] = self._strided(
                changed["bufferView"], changed.get("byteOffset", 0), dtype, sparse["count"], width
            )
        if accessor.get("normalized") and dtype.kind != "f":
            return np.maximum(values / np.iinfo(dtype).max, -1.0)
        return values

    def view(self, index: int) -> bytes:
        """Return the bytes of a buffer view."""
        view = self.item("bufferViews", index)
        start, length = view.get("byteOffset", 0), view["byteLength"]
        buffer = self._buffer(view["buffer"])
        if min(start, length) < 0 or start + length > len(buffer):
            raise UserError("a view beyond the end of its buffer: the file is cut off")
        return buffer[start : start + length]

    def uri(self, uri: str, what: str) -> bytes:
        """Read a data URI, or the file of a name where other files may be read."""
        if uri.startswith("data:"):
            head, _, data = uri.partition(",")
            try:
                if head.endswith(";base64"):
                    return base64.b64decode(data, validate=True)
            except binascii.Error as error:
                raise UserError(f"a data URI that is no base64 ({error})") from error
            return urllib.parse.unquote_to_bytes(data)
        if self.companions is None:
            raise UserError(
                f"{what} in another file ({shown(uri)}), and no file opens another one: export "
                "everything into one GLB"
            )
        return self.companions.read(urllib.parse.unquote(uri))

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            buffer = self.item("buffers", index)
            if "uri" in buffer:
                self._buffers[index] = self.uri(buffer["uri"], "a buffer")
            elif index == 0 and self._binary:
                self._buffers[index] = self._binary
            else:
                names = " or ".join(n for n in buffer.get("extensions", {}) if n in _COMPRESSED)
                raise UserError(f"a buffer without bytes{names and f', which {names} needs'}")
        return self._buffers[index]

    def _strided(
        self, view: int, offset: int, dtype: np.dtype[Any], count: int, width: int
    ) -> npt.NDArray[Any]:
        content, row = self.view(view), dtype.itemsize * width
        stride = self.item("bufferViews", view).get("byteStride", row)
        if (
            min(count, offset) < 0
            or stride < row
            or offset + (count - 1) * stride + row > len(content)
        ):
            raise UserError("an array beyond the end of its view: the file is cut off")
        shape, strides = (count, width), (stride, dtype.itemsize)
        return np.ndarray(shape, dtype, content, offset, strides)


def _json(content: bytes) -> Json:
    if content.startswith(b"glTF"):
        return {}
    parsed = json.loads(content.decode("utf-8-sig"))
    if not isinstance(parsed, dict):
        raise UserError("JSON that is no glTF")
    return parsed


def _chunks(content: bytes) -> tuple[Json, bytes]:
    if len(content) < 20:
        raise UserError("a GLB that ends within its header")
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        raise UserError(f"GLB version {version}, where 2 is read: export it as glTF 2.0")
    if length > len(content):
        raise UserError(f"a GLB of {len(content):,} of {length:,} bytes: the file is cut off")
    at = 12
    found: dict[bytes, bytes] = {}
    while at + 8 <= length:
        size, kind = struct.unpack_from("<I4s", content, at)
        if at + 8 + size > length:
            raise UserError("a GLB with a chunk beyond its end: the file is cut off")
        found.setdefault(kind, content[at + 8 : at + 8 + size])  # unknown ones are ignored
        at += 8 + size
    if b"JSON" not in found:
        raise UserError("a GLB without its JSON")
    return _json(found[b"JSON"]), found.get(b"BIN\0", b"")
