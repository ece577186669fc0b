"""Mesh files for tests: five corners, two faces, PLY's headers, and a writer of GLB files."""

import json
import struct
from typing import Any

import numpy as np

CORNERS = np.array([[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0], [0, 0, 4]], "<f4")
TWO = np.array([[0, 1, 2], [0, 2, 3]])
XYZ = "property float x\nproperty float y\nproperty float z\n"
VERTEX = f"element vertex 4\n{XYZ}"
LIST = "property list uchar int vertex_indices\n"
ROWS = "0 0 0\n2 0 0\n2 3 0\n0 3 0\n"


class Glb:
    """Collects accessors, and writes a GLB."""

    def __init__(self) -> None:
        self.accessors: list[dict] = []
        self.views: list[dict] = []
        self.body = b""
        self.top: dict[str, Any] = {}

    def view(self, content: bytes, **more: int) -> int:
        self.views.append(
            {"buffer": 0, "byteOffset": len(self.body), "byteLength": len(content), **more}
        )
        self.body += content + b"\0" * (-len(content) % 4)
        return len(self.views) - 1

    def add(self, array: np.ndarray, **more: Any) -> int:
        kinds = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
        width = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
        self.accessors.append(
            {
                "bufferView": self.view(np.ascontiguousarray(array).tobytes()),
                "componentType": kinds[array.dtype.str[1:]],
                "count": len(array),
                "type": width[array[0].size],
                **more,
            }
        )
        return len(self.accessors) - 1

    def json(self, primitive: dict, nodes: list[dict] | None = None, **top: Any) -> dict:
        primitives = primitive if isinstance(primitive, list) else [primitive]
        return {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": nodes or [{"mesh": 0}],
            "meshes": [{"primitives": primitives}],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.body)}],
            **top,
        }

    def bytes(self, primitive: dict, nodes: list[dict] | None = None, **top: Any) -> bytes:
        text = json.dumps(self.json(primitive, nodes, **top)).encode()
        text += b" " * (-len(text) % 4)
        body = struct.pack("<I4s", len(self.body), b"BIN\0") + self.body if self.body else b""
        size = 20 + len(text) + len(body)
        return struct.pack("<4sIII4s", b"glTF", 2, size, len(text), b"JSON") + text + body


def plain(glb: Glb, kind: str = "<u2", **more: Any) -> dict:
    position = glb.add(CORNERS[:4])
    index = glb.add(TWO.ravel().astype(kind))
    return {"attributes": {"POSITION": position}, "indices": index, **more}
