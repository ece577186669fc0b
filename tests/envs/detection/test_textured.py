"""Textured models of others: where they are found, what they hold, and every way to lack them."""

import hashlib
import re
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sada_gym.envs.detection.shapes import DIAGONAL, Material, find_shapes, fingerprint, textured
from sada_gym.errors import FileError, UserError

CLASSES = sorted({model.object_class for model in textured.listed_models()})
PAGE = Path(__file__).parents[3] / "docs/environments/textured-models.md"
OBJ = """mtllib side.mtl
v 0 0 0
v 1 0 0
v 1 2 0
v 0 2 0
v 0 0 5
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl body
f 1/1 2/2 3/3 4/4
usemtl glass
f 1 2 5
"""
MTL = """newmtl body
Kd 1 0.5 0.25
map_Kd Paint Shop/My Label.PNG
newmtl glass
Kd 0.1 0.1 0.1
d 0.4
"""


def _png(width: int = 2, height: int = 2) -> bytes:
    file = BytesIO()
    Image.new("RGB", (width, height), (10, 20, 30)).save(file, "PNG")
    return file.getvalue()


FILES = {"a/b/side.obj": OBJ, "a/b/side.mtl": MTL, "a/b/paint shop/my label.png": _png()}


def _pack(folder: Path, files: dict[str, str | bytes]) -> str:
    """Write the archive, and return the SHA-256 that the list has to name."""
    with zipfile.ZipFile(folder / "Some.sh3f", "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    contents = (c.encode() if isinstance(c, str) else c for c in files.values())
    return hashlib.sha256(b"".join(contents)).hexdigest()


@pytest.fixture
def listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict:
    """A list of one model; tests write its archive and change its row."""
    row = {
        "set": "sweethome3d",
        "archive": "Some.sh3f",
        "member": "a/b/side.obj",
        "object_class": "sign",
        "name": "side",
        "paint": ["bo*"],
        "author": "us",
        "licence": "MIT",
        "sha256": _pack(tmp_path, FILES),
    }
    models = textured._ModelList.model_validate
    monkeypatch.setattr(textured, "listed_models", lambda: models({"model": [row]}).model)
    monkeypatch.setenv(textured.FOLDER_VARIABLE, str(tmp_path))
    textured._load.cache_clear()
    yield row
    textured._load.cache_clear()


@pytest.mark.usefixtures("listed")
def test_colours_textures_and_glass_are_read_out_of_an_archive() -> None:
    (shape,) = find_shapes("sweethome3d", "sign")
    body, glass = shape.surfaces
    assert (shape.name, shape.double_sided) == ("sweethome3d/side", True)
    assert (body.name, body.colour, body.painted) == ("body", (1.0, 0.5, 0.25), True)
    assert body.texture.shape == (2, 2, 4)
    assert (glass.opacity, glass.material, glass.painted) == (0.4, Material.GLASS, False)
    assert np.unique(shape.materials, return_counts=True)[1].tolist() == [2, 1]
    # front +z of the file is +x, its +x is the left side
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    np.testing.assert_allclose((high - low) / (high - low)[0], [1, 0.2, 0.4], rtol=1e-5)
    corner = shape.vertices[(shape.uv == [1, 1]).all(axis=1)]
    np.testing.assert_allclose(corner, [[low[0], high[1], high[2]]], atol=1e-5)
    assert find_shapes("sweethome3d", "sign")[0] is shape


def test_what_is_missing_or_changed_is_a_sentence(tmp_path: Path, listed: dict) -> None:
    def refuses(message: str) -> None:
        with pytest.raises(
            FileError, match=rf"(?s){message}.*sudo apt install sweethome3d-furniture"
        ):
            find_shapes("sweethome3d", "sign")

    changed = {**FILES, "a/b/side.mtl": MTL.replace("0.5", "0.6")}
    _pack(tmp_path, changed)
    refuses("files with SHA-256")
    _pack(tmp_path, {name: FILES[name] for name in ("a/b/side.obj", "a/b/side.mtl")})
    refuses("no file 'Paint Shop/My Label.PNG' beside it")
    _pack(tmp_path, {"b/side.obj": OBJ})
    refuses("an archive without a/b/side.obj")
    listed["sha256"] = _pack(tmp_path, {**FILES, "a/b/paint shop/my label.png": _png()[:40]})
    refuses("'Paint Shop/My Label.PNG' that cannot be decoded")
    (tmp_path / "Some.sh3f").write_bytes((tmp_path / "Some.sh3f").read_bytes()[:99])
    refuses("a ZIP in .*Some.sh3f")
    (tmp_path / "Some.sh3f").unlink()
    refuses(f"Some.sh3f in {tmp_path} or {tmp_path / 'sweethome3d'} .* no such file")
    with pytest.raises(UserError, match="to be one of sign for the models of sweethome3d"):
        find_shapes("sweethome3d", "car")


def test_a_wide_texture_is_reduced(tmp_path: Path, listed: dict) -> None:
    picture = _png(8_000, 4)
    listed["sha256"] = _pack(tmp_path, {**FILES, "a/b/paint shop/my label.png": picture})
    (shape,) = find_shapes("sweethome3d", "sign")
    assert shape.surfaces[0].texture.shape == (1, 1_024, 4)
    assert shape.surfaces[0].texture[0, 0].tolist() == [10, 20, 30, 255]


def test_a_material_to_be_painted_has_to_exist(listed: dict) -> None:
    listed["paint"] = ["hull"]
    with pytest.raises(
        FileError, match="no material 'hull' that could be painted, but body, glass"
    ):
        find_shapes("sweethome3d", "sign")


@pytest.mark.parametrize("object_class", CLASSES)
def test_each_class_has_two_models_where_the_packages_are(object_class: str) -> None:
    missing = [str(path) for path in textured.FOLDERS.values() if not path.is_dir()]
    if missing:
        pytest.skip(f"Debian's packages of models are not installed: no {' and '.join(missing)}")
    shapes = find_shapes("textured", object_class)
    assert len(shapes) >= 2
    assert len({fingerprint([shape]) for shape in shapes}) == len(shapes)
    for shape in shapes:
        low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
        assert shape.surfaces
        assert len(shape.faces) <= 60_000
        assert np.linalg.norm(high - low) == pytest.approx(DIAGONAL, rel=1e-5)
        np.testing.assert_allclose([*(low + high)[:2], low[2]], 0, atol=1e-5)


def test_the_page_names_each_model_and_its_author() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for model in textured.listed_models():
        (row,) = re.findall(rf"^\| {model.object_class} \| .*\(.*$", page, re.MULTILINE)
        assert f"{model.name} ({model.author}, {model.licence})" in row
