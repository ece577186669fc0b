"""Each feature of each mesh format is read right or refused by name, as the docs list them."""

import base64
import json
import re
import struct
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mesh_files import CORNERS, LIST, ROWS, TWO, VERTEX, XYZ, Glb, plain

from sada_gym.envs.detection.shapes.cad import read_mesh
from sada_gym.errors import UserError

PAGE = Path(__file__).parents[3] / "docs/environments/mesh-files.md"
SQUARE = "v 0 0 0\nv 2 0 0\nv 2 3 0\nv 0 3 0\n"


@dataclass(frozen=True)
class Case:
    """A file of one feature: how many faces of which area it has, or why it is refused."""

    feature: str
    name: str
    content: bytes
    faces: int = 0
    area: float = 0.0
    refusal: str = ""

    def __str__(self) -> str:
        return f"{self.name.rpartition('.')[2]}: {self.feature}"


def _obj(feature: str, text: str, faces: int = 0, area: float = 0.0, refusal: str = "") -> Case:
    return Case(feature, "a.obj", text.encode(), faces, area, refusal)


L_SHAPE = "v 0 0 0\nv 0 2 0\nv 1 2 0\nv 1 1 0\nv 3 1 0\nv 3 0 0\n"
OBJ = [
    _obj("triangles, quads, polygons", SQUARE + "f 1 2 3\nf 1 3 4\nf 1 2 3 4\n", 4, 12),
    _obj("concave polygons", L_SHAPE + "f 4 5 6 1 2 3\n", 4, 4),
    _obj("concave quads", "v 0 0 0\nv 2 2 0\nv 4 0 0\nv 2 1 0\nf 1 4 3 2\n", 2, 2),
    _obj("negative indices", SQUARE + "f -4 -3 -2\nv 2 3 4\nf -1 -3 -2\n", 2, 3 + 4),
    _obj(
        "tabs, CR LF, a byte-order mark",
        "\ufeff" + SQUARE.replace(" ", "\t") + "f\t1 2 3\r\n",
        1,
        3,
    ),
    _obj("line continuations", SQUARE + "f 1 2 \\\n3\\\n4\n# C:\\temp\\\nf 1 2 3\n", 3, 9),
    _obj("`v/vt`, `v//vn`, `v/vt/vn`", SQUARE + "vt 0 0\nvn 0 0 1\nf 1/1 2//1 3/1/1\n", 1, 3),
    _obj(
        "`v` with a weight or a colour",
        SQUARE.replace(" 0\n", " 0 1\n") + "v 0 0 4 1 0 0\nf 1 2 5\n",
        1,
        4,
    ),
    _obj("points, lines, curves", SQUARE + "p 1\nl 1 2\ncurv 0 1 1 2\nend\nf 1 2 3\n", 1, 3),
    _obj(
        "groups, objects, smoothing",
        SQUARE + "o a b\ng\ns off\nusemtl x\nf 1 2 3\ng b\nf 1 3 4\n",
        2,
        6,
    ),
    _obj("faces of one or two corners", SQUARE + "f 1\nf 1 2\nf 1 2 3\n", 1, 3),
    _obj("the index 0", SQUARE + "f 0 1 2\n", refusal="a face with the vertex 0 in line 5"),
    _obj("missing vertices", SQUARE + "f 1 2 9\n", refusal="faces that point at missing vertices"),
    _obj(
        "negative indices out of range", SQUARE + "f -9 1 2\n", refusal="point at missing vertices"
    ),
    _obj("damaged numbers", SQUARE + "v 1,5 0 0\nf 1 2 3\n", refusal="line 5, which is damaged"),
    _obj(
        "free-form surfaces",
        SQUARE + "f 1 2 3\nsurf 0 1 0 1 1 2\n",
        refusal=r"a free-form surface \(surf\) in line 6",
    ),
    _obj(
        "calls of other files", SQUARE + "call a.obj\nf 1 2 3\n", refusal="a call of another file"
    ),
    _obj("unknown statements", SQUARE + "0.5 1 2\nf 1 2 3\n", refusal="no OBJ statement in line 5"),
]


def _binary_stl(header: bytes = b"", tail: bytes = b"", count: int = 2) -> bytes:
    body = b"".join(bytes(12) + CORNERS[face].tobytes() + bytes(2) for face in TWO)
    return header.ljust(80) + struct.pack("<I", count) + body + tail


def _facet(face: np.ndarray) -> str:
    corners = "".join("  VERTEX {} {} {}\n".format(*corner) for corner in CORNERS[face])
    return f" facet normal 0 0 0\n outer loop\n{corners} endloop\n endfacet\n"


def _stl(feature: str, content: bytes | str, faces: int = 0, refusal: str = "") -> Case:
    content = content.encode() if isinstance(content, str) else content
    return Case(feature, "a.stl", content, faces, 3.0 * faces, refusal)


STL = [
    _stl("binary", _binary_stl(), 2),
    _stl("binary, header begins with `solid`", _binary_stl(b"solid facet"), 2),
    _stl("binary, fewer than 50 bytes after the last face", _binary_stl(b"solid", bytes(4)), 2),
    _stl(
        "binary, 50 bytes or more after the last face",
        _binary_stl(tail=bytes(134)),
        refusal="134 bytes after its 2 faces",
    ),
    _stl("binary, cut off", _binary_stl(count=7), refusal="ends after 2 of 7 faces"),
    _stl("ASCII", f"solid a b\n{_facet(TWO[0])}endsolid a b\n", 1),
    _stl("ASCII, several solids", "".join(f"solid\n{_facet(f)}endsolid\n" for f in TWO), 2),
    _stl("ASCII, cut off", f"solid a\n{_facet(TWO[0])}", refusal="ends before its endsolid"),
    _stl(
        "ASCII, facets of four corners",
        f"solid a\n{_facet(np.array([0, 1, 2, 3]))}endsolid\n",
        refusal="line 7, which STL does not allow",
    ),
]


def _ply(
    feature: str,
    head: str,
    body: bytes | str,
    faces: int = 0,
    area: float = 0.0,
    refusal: str = "",
    form: str = "ascii",
) -> Case:
    content = body.encode() if isinstance(body, str) else body
    header = f"ply\nformat {form} 1.0\n{head}end_header\n".encode()
    return Case(feature, "a.ply", header + content, faces, area, refusal)


def _packed(order: str, size: str, index: str, polygons: list[list[int]]) -> bytes:
    rows = [
        np.array([len(row)], order + size).tobytes() + np.array(row, order + index).tobytes()
        for row in polygons
    ]
    return CORNERS[:4].astype(order + "f4").tobytes() + b"".join(rows)


PLY = [
    _ply("ASCII", f"comment façade\n{VERTEX}element face 1\n{LIST}", ROWS + "3 0 1 2\n", 1, 3),
    _ply(
        "little-endian",
        f"{VERTEX}element face 2\n{LIST}",
        _packed("<", "u1", "i4", [[0, 1, 2], [0, 2, 3]]),
        2,
        6,
        form="binary_little_endian",
    ),
    _ply(
        "big-endian",
        f"{VERTEX}element face 2\n{LIST}",
        _packed(">", "u1", "i4", [[0, 1, 2], [0, 2, 3]]),
        2,
        6,
        form="binary_big_endian",
    ),
    _ply(
        "lists of any types",
        f"{VERTEX}element face 1\nproperty list uint ushort vertex_index\n",
        _packed("<", "u4", "u2", [[0, 1, 2]]),
        1,
        3,
        form="binary_little_endian",
    ),
    _ply(
        "mixed polygons",
        f"{VERTEX}element face 2\n{LIST}",
        _packed("<", "u1", "i4", [[0, 1, 2, 3], [0, 2, 3]]),
        3,
        9,
        form="binary_little_endian",
    ),
    _ply(
        "several lists in a row",
        f"{VERTEX}element face 2\nproperty list char short skipped\n{LIST}property uchar k\n",
        CORNERS[:4].astype("<f4").tobytes()
        + struct.pack("<bB3iB", 0, 3, 0, 1, 2, 7)
        + struct.pack("<b2hB4iB", 2, -1, -1, 4, 0, 1, 2, 3, 7),
        3,
        9,
        form="binary_little_endian",
    ),
    _ply(
        "lists with a negative length",
        f"{VERTEX}element face 1\nproperty list char int vertex_indices\n",
        _packed("<", "i1", "i4", [[0, 1, 2]]).replace(b"\x03", b"\xff", 1) + bytes(9),
        refusal="ends within its rows",
        form="binary_little_endian",
    ),
    _ply(
        "concave polygons",
        f"element vertex 4\n{XYZ}element face 1\n{LIST}",
        "0 0 0 2 2 0 4 0 0 2 1 0\n4 0 3 2 1\n",
        2,
        2,
    ),
    _ply(
        "other elements and properties",
        "element edge 1\nproperty int a\nproperty list int int b\n"
        f"{VERTEX}property uchar red\n"
        f"element face 1\nproperty short k\n{LIST}property list uchar float w\n",
        "5 2 7 7\n" + ROWS.replace("0\n", "0 9\n") + "1 3 0 1 2 1 0.5\n",
        1,
        3,
    ),
    _ply(
        "`double` and sized type names",
        VERTEX.replace("float x", "float64 x") + f"element face 1\n{LIST}",
        ROWS + "3 0 1 2\n",
        1,
        3,
    ),
    _ply(
        "strips of triangles",
        f"{VERTEX}element tristrips 1\nproperty list int int vertex_indices\n",
        ROWS + "3 0 1 2\n",
        refusal=r"strips of triangles \(tristrips\)",
    ),
    _ply(
        "missing vertices",
        f"{VERTEX}element face 1\n{LIST}",
        ROWS + "3 0 1 4\n",
        refusal="point at missing vertices",
    ),
    _ply(
        "fractional indices",
        f"{VERTEX}element face 1\nproperty list uchar float vertex_indices\n",
        ROWS + "3 0 1 2.5\n",
        refusal="indices that are not whole numbers",
    ),
    _ply(
        "unknown statements and types",
        f"{VERTEX}property half u\nelement face 1\n{LIST}",
        ROWS,
        refusal="line 7, which PLY does not have",
    ),
    _ply(
        "cut off",
        f"{VERTEX}element face 2\n{LIST}",
        ROWS + "3 0 1 2\n3 0",
        refusal="ends within its rows",
    ),
    _ply(
        "without x, y, z or faces' vertices",
        f"element vertex 1\nproperty float x\nelement face 1\n{LIST}",
        "0 3 0 0 0\n",
        refusal="vertices without x, y and z",
    ),
]


def _gltf(
    feature: str,
    make: Callable[[Glb], bytes],
    faces: int = 0,
    area: float = 0.0,
    refusal: str = "",
    name: str = "a.glb",
) -> Case:
    return Case(feature, name, make(Glb()), faces, area, refusal)


def _indexed(kind: str) -> Callable[[Glb], bytes]:
    return lambda glb: glb.bytes(plain(glb, kind))


def _mode(mode: int) -> Callable[[Glb], bytes]:
    def make(glb: Glb) -> bytes:
        order = {5: [0, 1, 3, 2], 6: [0, 1, 2, 3]}.get(mode, [0, 1, 2])
        index = glb.add(np.array(order, "u1"))
        lines = {"attributes": {"POSITION": glb.add(CORNERS[:4])}, "indices": index, "mode": mode}
        return glb.bytes([plain(glb), lines] if mode < 4 else lines)

    return make


def _strided(glb: Glb) -> bytes:
    wide = np.zeros((4, 5), "<f4")
    wide[:, 1:4] = CORNERS[:4]
    primitive = plain(glb)
    view = glb.view(wide.tobytes(), byteStride=20)
    glb.accessors[0] |= {"bufferView": view, "byteOffset": 4}
    return glb.bytes(primitive)


def _sparse(glb: Glb, zeros: bool = False) -> bytes:
    primitive = plain(glb)
    rows = np.arange(4, dtype="<u2") if zeros else np.array([2, 3], "<u2")
    changed = CORNERS[:4] if zeros else CORNERS[2:4] * 2
    sparse = {
        "count": len(rows),
        "indices": {"bufferView": glb.view(rows.tobytes()), "componentType": 5123},
        "values": {"bufferView": glb.view(changed.astype("<f4").tobytes())},
    }
    glb.accessors[0]["sparse"] = sparse
    if zeros:
        del glb.accessors[0]["bufferView"]
    return glb.bytes(primitive)


def _quantized(glb: Glb) -> bytes:
    values = np.array([[0, 0, 0, 0], [127, 0, 0, 0], [127, 127, 0, 0], [0, 127, 0, 0]], "i1")
    view = glb.view(values.tobytes(), byteStride=4)
    primitive = plain(glb)
    glb.accessors[0] |= {"bufferView": view, "componentType": 5120, "normalized": True}
    nodes = [{"mesh": 0, "scale": [2, 3, 1]}]
    return glb.bytes(primitive, nodes, extensionsRequired=["KHR_mesh_quantization"])


def _nodes(nodes: list[dict], **top: Any) -> Callable[[Glb], bytes]:
    return lambda glb: glb.bytes(plain(glb), nodes, **top)


def _morphed(glb: Glb) -> bytes:
    shift = np.zeros((4, 3), "<f4")
    shift[2:, 1] = 3
    return glb.bytes(
        {**plain(glb), "targets": [{"POSITION": glb.add(shift)}]}, [{"mesh": 0, "weights": [2.0]}]
    )


def _skinned(glb: Glb) -> bytes:
    primitive = plain(glb)
    inverse = np.eye(4, dtype="<f4")
    inverse[3, 0] = -1
    primitive["attributes"] |= {
        "JOINTS_0": glb.add(np.array([[0, 1, 0, 0]] * 4, "u1")),
        "WEIGHTS_0": glb.add(
            np.array([[0, 0, 0, 0], [0, 0, 0, 0], [0, 255, 0, 0], [0, 255, 0, 0]], "u1")
            + np.array([255, 0, 0, 0], "u1") * np.array([[1], [1], [0], [0]], "u1"),
            normalized=True,
        ),
    }
    skin = {
        "joints": [1, 2],
        "inverseBindMatrices": glb.add(np.array([inverse.ravel(), np.eye(4).ravel()], "<f4")),
    }
    nodes = [
        {"mesh": 0, "skin": 0, "children": [1, 2], "translation": [0, 0, 0]},
        {"translation": [1, 0, 0]},
        {"translation": [0, 3, 0]},
    ]
    return glb.bytes(primitive, nodes, skins=[skin])


def _instanced(glb: Glb) -> bytes:
    primitive = plain(glb)
    places = {"TRANSLATION": glb.add(np.array([[0, 0, 0], [9, 0, 0]], "<f4"))}
    extension = {"EXT_mesh_gpu_instancing": {"attributes": places}}
    return glb.bytes(
        primitive,
        [{"mesh": 0, "extensions": extension}],
        extensionsRequired=["EXT_mesh_gpu_instancing"],
    )


def _data_uri(glb: Glb) -> bytes:
    primitive = plain(glb)
    uri = "data:application/octet-stream;base64," + base64.b64encode(glb.body).decode()
    buffer = {"byteLength": len(glb.body), "uri": uri}
    return json.dumps(glb.json(primitive, buffers=[buffer])).encode()


def _requires(*names: str) -> Callable[[Glb], bytes]:
    return _nodes([{"mesh": 0}], extensionsRequired=list(names))


def _broken(change: Callable[[Glb, dict], None]) -> Callable[[Glb], bytes]:
    def make(glb: Glb) -> bytes:
        primitive = plain(glb)
        change(glb, primitive)
        return glb.bytes(primitive)

    return make


TURNED = {"mesh": 0, "rotation": [0.5**0.5, 0, 0, 0.5**0.5], "scale": [2, 1, 1]}
MATRIX = np.diag([2.0, -1, 1, 1]).ravel().tolist()
GLTF = [
    _gltf("indices of 8 bits", _indexed("u1"), 2, 6),
    _gltf("indices of 16 bits", _indexed("<u2"), 2, 6),
    _gltf("indices of 32 bits", _indexed("<u4"), 2, 6),
    _gltf(
        "no indices",
        lambda glb: glb.bytes({"attributes": {"POSITION": glb.add(CORNERS[:3])}}),
        1,
        3,
    ),
    _gltf("strided views", _strided, 2, 6),
    _gltf("sparse accessors", _sparse, 2, 18),
    _gltf("sparse accessors without a view", lambda glb: _sparse(glb, zeros=True), 2, 6),
    _gltf("normalised integers (KHR_mesh_quantization)", _quantized, 2, 6),
    _gltf("points, lines", _mode(1), 2, 6),
    _gltf("triangle strips", _mode(5), 2, 6),
    _gltf("triangle fans", _mode(6), 2, 6),
    _gltf("other modes", _mode(7), refusal="a primitive of mode 7"),
    _gltf("nodes' translation, rotation, scale", _nodes([TURNED]), 2, 12),
    _gltf("nodes' matrices, mirrored ones too", _nodes([{"mesh": 0, "matrix": MATRIX}]), 2, 12),
    _gltf(
        "children of nodes, of cameras too",
        _nodes(
            [{"camera": 0, "scale": [2, 1, 1], "children": [1]}, {"mesh": 0}],
            cameras=[{"type": "perspective"}],
        ),
        2,
        12,
    ),
    _gltf(
        "several scenes",
        _nodes(
            [{"mesh": 0}, {"mesh": 0, "scale": [2, 2, 2]}],
            scene=1,
            scenes=[{"nodes": [0]}, {"nodes": [1]}],
        ),
        2,
        24,
    ),
    _gltf(
        "cyclic node graphs",
        _nodes([{"children": [1]}, {"mesh": 0, "children": [0]}]),
        refusal="a node with two parents, or below itself",
    ),
    _gltf("skins", _skinned, 2, 12),
    _gltf("morph targets, by the file's weights", _morphed, 2, 2 * 9),
    _gltf("EXT_mesh_gpu_instancing", _instanced, 4, 12),
    _gltf(
        "KHR_node_visibility",
        _nodes(
            [
                {"children": [1, 2]},
                {"mesh": 0},
                {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": False}}},
            ],
            extensionsRequired=["KHR_node_visibility"],
        ),
        2,
        6,
    ),
    _gltf(
        "KHR_materials_…, KHR_texture_transform, EXT_texture_webp",
        _requires("KHR_materials_unlit", "KHR_texture_transform", "EXT_texture_webp"),
        2,
        6,
    ),
    _gltf(
        "KHR_draco_mesh_compression",
        _requires("KHR_draco_mesh_compression"),
        refusal=r"Draco compression \(KHR_draco_mesh_compression\)",
    ),
    _gltf(
        "EXT_meshopt_compression, KHR_meshopt_compression",
        _requires("EXT_meshopt_compression"),
        refusal=r"meshopt compression \(EXT_meshopt_compression\)",
    ),
    _gltf(
        "any other extension that is required",
        _requires("XYZ_fur"),
        refusal="the required extension XYZ_fur",
    ),
    _gltf("JSON with data URIs (`.gltf`)", _data_uri, 2, 6, name="a.gltf"),
    _gltf(
        "buffers in other files",
        _nodes([{"mesh": 0}], buffers=[{"byteLength": 9, "uri": "a.bin"}]),
        refusal=r"a buffer in another file \(a.bin\).* export everything into one GLB",
    ),
    _gltf(
        "glTF 1.0",
        _nodes([{"mesh": 0}], asset={"version": "1.0"}),
        refusal="glTF 1.0, where 2.0 is read",
    ),
    _gltf(
        "missing vertices",
        _broken(lambda glb, p: p["attributes"].update(POSITION=glb.add(CORNERS[:3]))),
        refusal="point at missing vertices",
    ),
    _gltf(
        "views or arrays beyond the end",
        _broken(lambda glb, p: glb.accessors[0].update(count=5)),
        refusal="an array beyond the end of its view",
    ),
    _gltf(
        "references to nothing",
        _broken(lambda glb, p: p.update(indices=9)),
        refusal="a reference to number 9 of 2 accessors",
    ),
    _gltf("cut off", lambda glb: glb.bytes(plain(glb))[:-9], refusal="the file is cut off"),
]
CASES = [*OBJ, *STL, *PLY, *GLTF]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_each_feature_is_read_or_refused(tmp_path: Path, case: Case) -> None:
    file = tmp_path / case.name
    file.write_bytes(case.content)
    if case.refusal:
        with pytest.raises(UserError, match=case.refusal):
            read_mesh(file)
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = read_mesh(file)
    assert len(mesh.faces) == case.faces
    a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx(case.area, rel=1e-3)


def test_the_page_lists_each_case() -> None:
    kinds = {".obj": "OBJ", ".stl": "STL", ".ply": "PLY", ".glb": "glTF", ".gltf": "glTF"}
    listed = []
    for kind, section in re.findall(r"^## (\S+)\n(.*?)(?=^#|\Z)", PAGE.read_text(), re.M | re.S):
        for word, items in re.findall(r"^- \*\*(.+?)\*\*: (.*?)(?=^- |\n\n)", section, re.M | re.S):
            features = re.sub(r"\s+", " ", items).strip().split("; ")
            rejected = word == "Rejected"
            listed += [(kind, feature.partition(": ")[0], rejected) for feature in features]
    expected = [(kinds[Path(case.name).suffix], case.feature, bool(case.refusal)) for case in CASES]
    assert sorted(listed) == sorted(expected)
