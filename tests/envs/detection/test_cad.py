"""A user's own CAD files: types, orientation, and every way in which a folder can be wrong."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from sada_gym.envs.detection.shapes import DIAGONAL, Material, benchmark_shapes, fingerprint
from sada_gym.envs.detection.shapes.cad import load_folder

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
        ValueError, match=rf"{name}, got .*; export it anew, remove it, or pass skip"
    ):
        load_folder(tmp_path)
    with pytest.warns(UserWarning, match=name):
        shapes = load_folder(tmp_path, skip_unreadable=True)
    assert [shape.name for shape in shapes["car"]] == ["car/good.obj"]


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
    with pytest.raises(ValueError, match=rf"shapes\.json to be such as .*{flaw}.*; mend it"):
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
