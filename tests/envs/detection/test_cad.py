"""A user's own CAD files: types, orientation, and every way in which a folder can be wrong."""

import json
import os
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from sada_gym.envs.detection.shapes import (
    DIAGONAL,
    Material,
    benchmark_shapes,
    fingerprint,
    triangles,
)
from sada_gym.envs.detection.shapes.cad import load_folder, read_mesh
from sada_gym.errors import UserError

SIZE = np.array([1.0, 2.0, 3.0])
"""Of the test box along its file's x, y and z."""


def _write(folder: Path, name: str = "car/box.obj", *, extents: np.ndarray = SIZE) -> Path:
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    mesh = trimesh.creation.box(extents=extents)
    mesh.apply_translation([5.0, -7.0, 11.0])
    mesh.export(file)
    return file


def _extent(folder: Path) -> np.ndarray:
    (shape,) = load_folder(folder)["car"]
    return np.ptp(shape.vertices, axis=0) * np.linalg.norm(SIZE) / DIAGONAL


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb"])
def test_every_file_type_is_centred_grounded_scaled_and_turned(tmp_path: Path, suffix: str) -> None:
    _write(tmp_path, f"car/box.{suffix}")
    (shape,) = load_folder(tmp_path)["car"]
    assert (shape.name, shape.object_class) == (f"car/box.{suffix}", "car")
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    np.testing.assert_allclose((low + high)[:2], 0, atol=1e-5)
    assert low[2] == pytest.approx(0, abs=1e-6)
    assert np.linalg.norm(high - low) == pytest.approx(DIAGONAL, rel=1e-5)
    # The front is the file's -z, up its +y.
    np.testing.assert_allclose(_extent(tmp_path), [3, 1, 2], rtol=1e-5)
    assert (shape.materials == Material.PAINT).all()
    assert (len(shape.faces), len(shape.vertices)) == (12, 24)


@pytest.mark.parametrize(
    ("up", "front", "expected"),
    [("+z", "+x", (1, 2, 3)), ("+z", "-y", (2, 1, 3)), ("+y", "+x", (1, 3, 2))],
)
def test_shapes_json_gives_the_orientation(
    tmp_path: Path, up: str, front: str, expected: tuple[float, ...]
) -> None:
    _write(tmp_path)
    (tmp_path / "shapes.json").write_text(json.dumps({"up": up, "front": front}))
    np.testing.assert_allclose(_extent(tmp_path), expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("config", "nose", "left"),
    [
        (None, (0, 0, -1), (-1, 0, 0)),
        ({"up": "+z", "front": "+x"}, (1, 0, 0), (0, 1, 0)),
        ({"up": "-z", "front": "+y"}, (0, 1, 0), (1, 0, 0)),
    ],
)
def test_front_and_left_end_where_they_should(
    tmp_path: Path, config: dict | None, nose: tuple, left: tuple
) -> None:
    """A long spike marks the front and a short one the left."""
    body = trimesh.creation.box(extents=[1, 1, 1])
    spikes = [
        trimesh.creation.box(
            extents=[0.2] * 3, transform=trimesh.transformations.translation_matrix(at)
        )
        for at in (3 * np.array(nose), 2 * np.array(left))
    ]
    (tmp_path / "car").mkdir()
    trimesh.util.concatenate([body, *spikes]).export(tmp_path / "car" / "spiked.ply")
    if config is not None:
        (tmp_path / "shapes.json").write_text(json.dumps(config))
    (shape,) = load_folder(tmp_path)["car"]
    faces = shape.vertices[shape.faces].mean(axis=1)
    # The body holds most faces' middle; the spikes reach farther ahead and to the left.
    middle = (shape.vertices.max(axis=0) + shape.vertices.min(axis=0)) / 2
    body_middle = np.median(faces, axis=0)
    assert body_middle[0] < middle[0]
    assert body_middle[1] < middle[1]
    assert np.ptp(shape.vertices[:, 0]) > np.ptp(shape.vertices[:, 1])


def test_scenes_are_merged_in_their_places(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for x in (0.0, 9.0):
        matrix = trimesh.transformations.translation_matrix([x, 0, 0])
        scene.add_geometry(trimesh.creation.box(extents=[1, 1, 1]), transform=matrix)
    (tmp_path / "chair").mkdir()
    scene.export(tmp_path / "chair" / "pair.glb")
    (shape,) = load_folder(tmp_path)["chair"]
    extent = np.ptp(shape.vertices, axis=0)
    np.testing.assert_allclose(extent / extent[0], [1, 10, 1], rtol=1e-4)


def test_windings_are_made_outward_and_consistent(tmp_path: Path) -> None:
    mesh = trimesh.creation.box(extents=SIZE)
    faces = mesh.faces.copy()
    faces[::3] = faces[::3, ::-1]
    (tmp_path / "car").mkdir()
    trimesh.Trimesh(mesh.vertices, faces, process=False).export(tmp_path / "car" / "mixed.ply")
    (shape,) = load_folder(tmp_path)["car"]
    outward = shape.vertices - [0, 0, shape.height / 2]
    assert (np.einsum("vi,vi->v", outward, shape.normals) > 0).all()


def test_bodies_that_touch_in_an_edge_are_each_turned_outward(tmp_path: Path) -> None:
    """Four faces meet in that edge; an open sheet and a strip without two sides stay whole."""
    boxes = [trimesh.creation.box(extents=[1, 1, 1]) for _ in range(2)]
    boxes[1].vertices += [1, 1, 0]
    boxes[1].faces = boxes[1].faces[:, ::-1]
    sheet = trimesh.Trimesh([[5, 0, 0], [6, 0, 0], [6, 1, 0]], [[0, 1, 2]])
    half = np.repeat(np.linspace(0, np.pi, 9)[:-1], 2)
    across = 1 + 0.4 * np.tile([-1, 1], 8) * np.cos(half)
    strip = np.stack([across * np.cos(2 * half), across * np.sin(2 * half)], 1)
    strip = np.column_stack([strip, 3 + 0.4 * np.tile([-1, 1], 8) * np.sin(half)])
    following = [2 * k + 2 + j if k < 7 else 1 - j for k in range(8) for j in (0, 1)]
    faces = [[2 * k, following[2 * k], 2 * k + 1] for k in range(8)]
    faces += [[2 * k + 1, following[2 * k], following[2 * k + 1]] for k in range(8)]
    moebius = trimesh.Trimesh(strip, faces, process=False)
    trimesh.util.concatenate([*boxes, sheet, moebius]).export(tmp_path / "all.stl")
    mesh = read_mesh(tmp_path / "all.stl")
    assert len(mesh.faces) == 12 + 12 + 1 + 16
    corners = mesh.vertices[mesh.faces]
    for box, faces in zip(boxes, (slice(0, 12), slice(12, 24)), strict=True):
        a, b, c = corners[faces].swapaxes(0, 1)
        outward = corners[faces].mean(axis=1) - box.vertices.mean(axis=0)
        assert (np.einsum("fi,fi->f", np.cross(b - a, c - a), outward) > 0).all()


def test_nested_files_and_companions_are_as_shapenet_has_them(tmp_path: Path) -> None:
    _write(tmp_path, "car/1a2b/models/model_normalized.obj")
    _write(tmp_path, "bus/coach.stl")
    (tmp_path / "car/1a2b/models/model_normalized.json").write_text("{}")
    (tmp_path / "car/.DS_Store").write_text("")
    (tmp_path / ".git").mkdir()
    shapes = load_folder(tmp_path)
    assert list(shapes) == ["bus", "car"]
    assert shapes["car"][0].name == "car/1a2b/models/model_normalized.obj"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("garbage.obj", b"\x00\xff not a mesh"),
        ("garbage.ply", b"ply\nformat nonsense\n"),
        ("garbage.stl", b"solid?"),
        ("garbage.glb", b"glTF\x02\x00"),
        ("empty.obj", b""),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("infinite.obj", b"v inf 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("line.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"),
        ("missing.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 9\n"),
    ],
)
def test_bad_meshes_are_named_or_left_out(tmp_path: Path, name: str, content: bytes) -> None:
    _write(tmp_path, "car/good.obj")
    bad = tmp_path / "car" / name
    bad.write_bytes(content)
    with pytest.raises(
        ValueError, match=rf"{name}, got .*; export it again, remove it, or pass skip"
    ):
        load_folder(tmp_path)
    with pytest.warns(UserWarning, match=name):
        shapes = load_folder(tmp_path, skip_unreadable=True)
    assert [shape.name for shape in shapes["car"]] == ["car/good.obj"]


TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
PLY = """ply
format {} 1.0
comment façade
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
"""
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4")
FACES = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])


def _without_encoding_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("chardet", "charset_normalizer"):
        monkeypatch.setitem(sys.modules, name, None)


def _stl(text: str) -> bytes:
    solid = trimesh.exchange.stl.export_stl_ascii(trimesh.Trimesh(CORNERS, FACES))
    return solid.replace("solid", f"solid {text}", 1).encode("latin-1")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", ("# façade\nmtllib a.mtl\no Brücke\n" + TETRAHEDRON).encode("latin-1")),
        ("b.obj", ("\ufeff" + TETRAHEDRON).encode("utf-8")),
        ("c.obj", TETRAHEDRON.encode("utf-16")),
        ("d.obj", ("# façade\n" + TETRAHEDRON).encode("utf-8")),
        (
            "e.ply",
            (
                PLY.format("ascii")
                + "".join("{} {} {}\n".format(*corner) for corner in CORNERS)
                + "".join("3 {} {} {}\n".format(*face) for face in FACES)
            ).encode("latin-1"),
        ),
        (
            "f.ply",
            PLY.format("binary_little_endian").encode("latin-1")
            + CORNERS.tobytes()
            + b"".join(b"\x03" + face.astype("<i4").tobytes() for face in FACES),
        ),
        ("g.stl", _stl("façade")),
        (
            "h.stl",
            "façade".encode("latin-1").ljust(80)
            + trimesh.exchange.stl.export_stl(trimesh.Trimesh(CORNERS, FACES))[80:],
        ),
    ],
)
def test_comments_may_be_in_any_encoding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, content: bytes
) -> None:
    """Trimesh reads what is not UTF-8 by a package that need not be installed."""
    _without_encoding_packages(monkeypatch)
    (tmp_path / "car").mkdir()
    (tmp_path / "car" / name).write_bytes(content)
    (tmp_path / "car" / "a.mtl").write_bytes("# façade\nnewmtl Lack\n".encode("latin-1"))
    (shape,) = load_folder(tmp_path)["car"]
    assert len(shape.faces) == 4


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", ["1e10", "1e38", "1e155", "1e300", "-1.7e308"])
def test_coordinates_that_overflow_are_a_sentence(tmp_path: Path, value: str) -> None:
    (tmp_path / "car").mkdir()
    file = tmp_path / "car" / "far.obj"
    file.write_text(TETRAHEDRON.replace("v 1 0 0", f"v {value} 0 0"))
    with pytest.raises(UserError, match=r"far\.obj, got coordinates up to .*: scale it down"):
        load_folder(tmp_path)


@pytest.mark.parametrize("face", ["f 0 1 2", "  f 1/2/3 00//1 3", "f 1 2 \\\n 0 # 9", "f 1 -0 3"])
def test_a_face_with_the_vertex_0_is_refused(tmp_path: Path, face: str) -> None:
    (tmp_path / "car").mkdir()
    text = f"# f 0 0 0\n{TETRAHEDRON.strip()}\n\n{face}\n"
    (tmp_path / "car" / "zero.obj").write_text(text)
    line = text.count("\n")
    with pytest.raises(
        UserError, match=rf"zero\.obj, got a face with the vertex 0 in line {line}, w"
    ):
        load_folder(tmp_path)


def test_faces_may_count_vertices_backwards(tmp_path: Path) -> None:
    (tmp_path / "car").mkdir()
    vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    for name, faces in (
        ("a", "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"),
        ("b", "f -4 -2 -3\nf -4 -3 -1\nf -4 -1 -2\nf -3 -2 -1\n"),
    ):
        (tmp_path / "car" / f"{name}.obj").write_text(vertices + faces)
    first, second = load_folder(tmp_path)["car"]
    np.testing.assert_array_equal(first.vertices, second.vertices)


def test_large_coordinates_are_loaded(tmp_path: Path) -> None:
    _write(tmp_path, extents=SIZE * 1e8)
    np.testing.assert_allclose(_extent(tmp_path), [3, 1, 2], rtol=1e-5)


def test_too_many_faces_are_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(triangles, "MAX_FACES", 11)
    _write(tmp_path)
    with pytest.raises(UserError, match=r"got 12 faces, where at most 11 .*Decimate modifier"):
        load_folder(tmp_path)


def _glb(buffer: dict, nodes: list[dict] | None = None, vertices: int = 4) -> bytes:
    body = CORNERS.tobytes() + FACES.astype("<u2").tobytes()
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes or [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 24},
        ],
        "buffers": [{"byteLength": 72, **buffer}],
    }
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if "uri" not in buffer:
        chunks += struct.pack("<II", len(body), 0x004E4942) + body
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def test_a_file_reads_no_other_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Buffers, materials and pictures that a file names are never opened, wherever they lie."""
    outside = tmp_path / "outside.bin"
    outside.write_bytes(CORNERS.tobytes() + FACES.astype("<u2").tobytes())
    folder = tmp_path / "cad" / "car"
    folder.mkdir(parents=True)
    opened: list[str] = []

    def note(self: Path, *arguments: object) -> bytes:
        opened.append(self.name)
        with open(self, "rb") as file:
            return file.read()

    monkeypatch.setattr(Path, "read_bytes", note)
    for name, uri in (("a", "../../outside.bin"), ("b", str(outside)), ("c", outside.as_uri())):
        (folder / f"{name}.glb").write_bytes(_glb({"uri": uri}))
    (folder / "good.obj").write_text(f"mtllib ../../outside.bin\nmtllib {outside}\n" + TETRAHEDRON)
    with pytest.warns(UserWarning, match="Left out"):
        (shape,) = load_folder(tmp_path / "cad", skip_unreadable=True)["car"]
    assert shape.name == "car/good.obj"
    assert opened == ["a.glb", "b.glb", "c.glb", "good.obj"]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("vertices.ply", PLY.replace("vertex 4", "vertex 1000000000000").format("ascii").encode()),
        (
            "vertices-binary.ply",
            PLY.replace("4", "999999999999").format("binary_little_endian").encode() + bytes(99),
        ),
        ("faces.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50)),
        ("vertices.glb", _glb({}, vertices=2**40)),
        ("loop.glb", _glb({}, [{"children": [1]}, {"children": [0], "mesh": 0}])),
        (
            "nested.glb",
            b"glTF" + struct.pack("<IIII", 2, 99_020, 99_000, 0x4E4F534A) + b"[" * 99_000,
        ),
    ],
)
def test_bombs_are_harmless(tmp_path: Path, name: str, content: bytes) -> None:
    """Small files that announce more than any memory holds, or never end."""
    (tmp_path / "car").mkdir()
    (tmp_path / "car" / name).write_bytes(content)
    with pytest.raises(UserError, match=rf"{name}, got "):
        load_folder(tmp_path)


def test_a_mesh_in_many_places_is_counted_before_it_is_laid_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A few hundred kilobytes that would become 100 million faces."""
    monkeypatch.setattr(triangles, "MAX_FACES", 3_999)
    (tmp_path / "car").mkdir()
    nodes = [{"children": list(range(1, 1_001))}, *[{"mesh": 0}] * 1_000]
    (tmp_path / "car" / "copies.glb").write_bytes(_glb({}, nodes))
    with pytest.raises(UserError, match=r"got 4,000 faces, where at most 3,999"):
        load_folder(tmp_path)


def test_what_is_no_file_is_a_sentence(tmp_path: Path) -> None:
    """A FIFO would be waited for, and /dev/zero has no end."""
    (tmp_path / "car").mkdir()
    os.mkfifo(tmp_path / "car" / "pipe.obj")
    with pytest.raises(UserError, match=r"pipe\.obj, got something that is not a file"):
        load_folder(tmp_path)
    (tmp_path / "car" / "pipe.obj").unlink()
    (tmp_path / "car" / "zero.obj").symlink_to("/dev/zero")
    with pytest.raises(UserError, match=r"zero\.obj, got something that is not a file"):
        load_folder(tmp_path)


def test_bad_folders_are_explained(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"Expected a folder of CAD files, got .*nowhere"):
        load_folder(tmp_path / "nowhere")
    with pytest.raises(ValueError, match=r"one folder a class, got none; move the files"):
        load_folder(tmp_path)
    (tmp_path / "car").mkdir()
    with pytest.raises(ValueError, match=r"at least one mesh of class 'car' .* got none; add"):
        load_folder(tmp_path)
    (tmp_path / "car" / "model.fbx").write_text("")
    with pytest.raises(ValueError, match=r"files of type .glb, .obj, .*model.fbx; convert"):
        load_folder(tmp_path)


def test_pickles_are_never_opened(tmp_path: Path) -> None:
    _write(tmp_path)
    (tmp_path / "car" / "box.pkl").write_bytes(b"cos\nsystem\n(S'exit 1'\ntR.")
    with pytest.raises(ValueError, match=r"box.pkl; convert or remove it"):
        load_folder(tmp_path, skip_unreadable=True)


@pytest.mark.parametrize(
    ("text", "flaw"),
    [
        ('{"upp": "+z"}', "upp: Extra inputs are not permitted"),
        ('{"up": "z"}', r"up: Input should be '\+x'"),
        ('{"up": "+z", "front": "-z"}', r"two different axes, got \+z and -z"),
        ("{", "Invalid JSON"),
        ("[1]", "file: "),
    ],
)
def test_bad_orientation_is_explained(tmp_path: Path, text: str, flaw: str) -> None:
    _write(tmp_path)
    (tmp_path / "shapes.json").write_text(text)
    with pytest.raises(ValueError, match=rf"shapes\.json to be such as .*{flaw}.*; fix it"):
        load_folder(tmp_path)


def test_fingerprint_sees_every_change(tmp_path: Path) -> None:
    _write(tmp_path)
    shapes = load_folder(tmp_path)["car"]
    assert fingerprint(shapes) == fingerprint(load_folder(tmp_path)["car"])
    assert len(fingerprint(shapes)) == 64
    _write(tmp_path, extents=SIZE * [1, 1, 1.01])
    assert fingerprint(shapes) != fingerprint(load_folder(tmp_path)["car"])
    chairs = benchmark_shapes("chair")
    assert fingerprint(chairs) != fingerprint(chairs[::-1])
    assert fingerprint(chairs) != fingerprint(chairs[:-1])
