"""A user's folder whose files are drawn with their own materials and textures."""

import json
from io import BytesIO
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
from mesh_files import CORNERS, LIST, ROWS, XYZ, Glb, plain
from PIL import Image

from sada_gym.envs.detection.shapes import Material, Shape, fingerprint, load_folder
from sada_gym.errors import UserError

TEXTURES = {"up": "+z", "front": "+x", "textures": True}
OBJ = """mtllib my car.mtl
v 0 0 0
v 2 0 0
v 2 3 0
v 0 3 0
v 0 0 4
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl Car Paint
f 1/1 2/2 3/3
f 1 3 4
usemtl glass
f 1 2 5
"""
MTL = """newmtl Car Paint
Kd 0 0 0
map_Kd -s 2 3 -o 0.5 0 Maps\\A B.png
newmtl glass
Kd 0.2 0.3 0.4
Tr 0.25
newmtl unused
map_Kd nowhere.png
"""


def _png() -> bytes:
    """Encode four texels: red and green above, blue and a hole below."""
    texels = [[(255, 0, 0, 255), (0, 255, 0, 255)], [(0, 0, 255, 255), (9, 9, 9, 0)]]
    file = BytesIO()
    Image.fromarray(np.array(texels, np.uint8)).save(file, "PNG")
    return file.getvalue()


def _folder(root: Path, settings: dict | None = None, **files: str | bytes) -> Path:
    for name, content in {"shapes.json": json.dumps(settings or TEXTURES), **files}.items():
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content.encode() if isinstance(content, str) else content)
    return root


def _obj(root: Path, settings: dict | None = None, **changed: str | bytes) -> Path:
    files = {"car/a.obj": OBJ, "car/my car.mtl": MTL, "car/maps/a b.PNG": _png(), **changed}
    return _folder(root, settings, **files)


def _uv(shape: Shape, corner: tuple[float, ...]) -> list[float]:
    """Return the texture coordinates of a file's corner in its first textured face."""
    face = shape.faces[[shape.surfaces[m].texture is not None for m in shape.materials]][0]
    places = shape.vertices[face]
    low = shape.vertices.min(axis=0)
    scale = 4 / np.ptp(shape.vertices[:, 2])
    distance = np.linalg.norm((places - low) * scale - corner, axis=1)
    assert distance.min() < 1e-4
    return shape.uv[face][distance.argmin()].tolist()


def test_materials_of_obj_files_are_drawn(tmp_path: Path) -> None:
    (shape,) = load_folder(_obj(tmp_path))["car"]
    surfaces = {(s.name, s.texture is not None): s for s in shape.surfaces}
    # Kd 0 0 0 beside a texture means the texture alone; a face without vt has no texture
    assert set(surfaces) == {("Car Paint", True), ("Car Paint", False), ("glass", False)}
    assert surfaces["Car Paint", True].colour == (1, 1, 1)
    assert surfaces["Car Paint", True].texture[:, :, 3].tolist() == [[255, 255], [255, 0]]
    assert surfaces["glass", False].opacity == 0.75
    assert surfaces["glass", False].material == Material.GLASS
    assert not any(surface.painted for surface in shape.surfaces)
    assert [_uv(shape, corner) for corner in ((0, 0, 0), (2, 3, 0))] == [[0.5, 0], [2.5, 3]]


@pytest.mark.parametrize(
    ("written", "used"),
    [
        ("Material #25", "Material #25"),
        ("#25", "#25"),
        ("a\tb ", "a\tb"),
        ('"quoted"', '"quoted"'),
        ("Grün", "Grün"),
        ("red", "red # a comment"),
        ("red # a comment", "red"),
        ("red # a comment", "red # a comment"),
    ],
)
def test_names_may_hold_a_hash_and_lines_a_comment(written: str, used: str, tmp_path: Path) -> None:
    vertices = "v 0 0 0 # a\nv 2 0 0\nv 2 3 0\nv 0 0 4\nvt 0 0\n"
    _folder(
        tmp_path,
        **{
            "car/a.obj": f"mtllib a #1.mtl\nmtllib other.mtl b.mtl # two\n{vertices}usemtl {used}\n"
            "f 1/1 2/1 3/1 # textured\nusemtl Material #26\nf 1 2 4\n",
            "car/a #1.mtl": "newmtl Material #26\nKd 0 0 1\nmap_d # none\n",
            "car/other.mtl": f"newmtl {written}\nKd 1 0 0 # red\nmap_Kd tile #2.png\n",
            "car/b.mtl": "# nothing\n",
            "car/tile #2.png": _png(),
        },
    )
    (shape,) = load_folder(tmp_path)["car"]
    seen = {(s.colour, s.texture is not None) for s in (shape.surfaces[i] for i in shape.materials)}
    assert seen == {((1.0, 0.0, 0.0), True), ((0.0, 0.0, 1.0), False)}


@pytest.mark.parametrize("name", ["Material #27", "#27", "material #26"])
def test_a_name_with_a_hash_that_no_file_defines_is_refused(name: str, tmp_path: Path) -> None:
    _folder(
        tmp_path,
        **{
            "car/a.obj": f"mtllib a.mtl\nv 0 0 0\nv 2 0 0\nv 2 3 0\nv 0 0 4\nusemtl {name}\n"
            "f 1 2 3\nf 1 2 4\n",
            "car/a.mtl": "newmtl Material #26\nKd 0 0 1\n",
        },
    )
    with pytest.raises(UserError, match=f"a material '{name}' that no material file defines"):
        load_folder(tmp_path)


def test_chosen_materials_take_the_paint(tmp_path: Path) -> None:
    painted = _obj(tmp_path, {**TEXTURES, "paint": ["body*", "Car*"]})
    (shape,) = load_folder(painted)["car"]
    assert {s.name for s in shape.surfaces if s.painted} == {"Car Paint"}
    _obj(tmp_path, {**TEXTURES, "paint": ["body*"]})
    with pytest.raises(
        UserError, match=r"no material 'body\*' that could be painted, but Car Paint"
    ):
        load_folder(tmp_path)
    _obj(tmp_path, {"paint": ["body*"]})
    with pytest.raises(UserError, match=r'"textures": true beside "paint"'):
        load_folder(tmp_path)


def test_without_textures_all_is_painted_and_fingerprints_differ(tmp_path: Path) -> None:
    prints = []
    for textures in (False, True):
        (shape,) = load_folder(_obj(tmp_path, {**TEXTURES, "textures": textures}))["car"]
        assert bool(shape.surfaces) == textures
        prints.append(fingerprint([shape]))
    assert prints[0] != prints[1]
    picture = BytesIO()
    Image.new("RGB", (2, 2)).save(picture, "PNG")
    _obj(tmp_path, **{"car/maps/a b.PNG": picture.getvalue()})
    assert fingerprint(load_folder(tmp_path)["car"]) != prints[1]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"car/my car.mtl": MTL.replace("A B", "C")}, r"no file 'Maps.+C.png' beside it"),
        ({"car/a.obj": OBJ.replace("my car", "your")}, "no file 'your.mtl' beside it"),
        ({"car/my car.mtl": MTL.replace("glass", "gas")}, "a material 'glass' that no material"),
        ({"car/my car.mtl": MTL.replace("-s 2 3", "-clamp on")}, "with the option -clamp, which"),
        ({"car/my car.mtl": MTL.replace("0.25", "a")}, "'glass' whose Kd, Ks, d or Tr"),
        ({"car/a.obj": OBJ.replace("1/1", "1/9")}, "point at missing texture coordinates"),
        ({"car/a.obj": OBJ.replace("v 0 0 4", "v 0 0 4 1 0 0")}, "colours of vertices, which"),
        ({"car/maps/a b.PNG": b"GIF89a"}, "a texture 'Maps.+A B.png' that cannot be decoded"),
    ],
)
def test_what_lacks_is_a_sentence_and_can_be_left_out(
    tmp_path: Path, changed: dict[str, str | bytes], message: str
) -> None:
    _obj(tmp_path, **changed)
    with pytest.raises(UserError, match=message):
        load_folder(tmp_path)
    good = OBJ.replace("mtllib", "# ").replace("usemtl", "# ")
    _obj(tmp_path, **{**changed, "car/good.obj": good})
    with pytest.warns(UserWarning, match=message):
        (shape,) = load_folder(tmp_path, skip_unreadable=True)["car"]
    assert shape.name == "car/good.obj"


@pytest.mark.parametrize("name", ["../secret.png", "{root}/secret.png", "link.png"])
def test_no_file_outside_the_folder_is_read(tmp_path: Path, name: str) -> None:
    (tmp_path / "secret.png").write_bytes(_png())
    name = name.format(root=tmp_path)
    cad = _obj(tmp_path / "cad", **{"car/my car.mtl": MTL.replace("Maps\\A B.png", name)})
    (cad / "car/link.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(UserError, match=r"no file '.*\.png' beside it"):
        load_folder(cad)


def test_materials_of_gltf_files_are_drawn(tmp_path: Path) -> None:
    glb = Glb()
    primitive = {**plain(glb), "material": 0}
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], "<f4")
    primitive["attributes"]["TEXCOORD_1"] = glb.add(uv)
    tower = {"attributes": {"POSITION": glb.add(CORNERS[[0, 1, 4]])}, "material": 1}
    transform = {"offset": [0.25, 0], "scale": [2, 1], "texCoord": 1}
    texture = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    metal = {"baseColorFactor": [0.5, 1, 0, 1], "baseColorTexture": texture}
    top = {
        "materials": [
            {"name": "label", "pbrMetallicRoughness": metal, "alphaMode": "MASK"},
            {
                "alphaMode": "BLEND",
                "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.5]},
            },
        ],
        "textures": [{"source": 0}],
        "images": [{"bufferView": glb.view(_png()), "mimeType": "image/png"}],
    }
    _folder(tmp_path, **{"car/a.glb": glb.bytes([primitive, tower], **top)})
    (shape,) = load_folder(tmp_path)["car"]
    label, glass = shape.surfaces
    assert (label.name, label.material) == ("label", Material.DARK)
    assert label.colour == pytest.approx((0.7354, 1, 0), abs=1e-3)  # linear 0.5 in sRGB
    assert label.texture[:, :, 3].tolist() == [[255, 255], [255, 0]]
    assert (glass.opacity, glass.material) == (0.5, Material.GLASS)
    # glTF counts v downwards
    assert [_uv(shape, corner) for corner in ((0, 0, 0), (2, 3, 0))] == [[0.25, 1], [2.25, 0]]

    top["images"] = [{"uri": quote("a b.png")}]
    _folder(tmp_path, **{"car/a.glb": glb.bytes([primitive, tower], **top)})
    with pytest.raises(UserError, match=r"no file 'a b\.png' beside it"):
        load_folder(tmp_path)
    _folder(tmp_path, **{"car/a b.png": _png()})
    assert fingerprint(load_folder(tmp_path)["car"]) == fingerprint([shape])

    primitive["attributes"]["COLOR_0"] = glb.add(CORNERS[:4])
    _folder(tmp_path, **{"car/a.glb": glb.bytes([primitive, tower], **top)})
    with pytest.raises(UserError, match="colours of vertices, which are not drawn"):
        load_folder(tmp_path)


def test_textures_of_ply_files_are_drawn(tmp_path: Path) -> None:
    head = "ply\nformat ascii 1.0\ncomment TextureFile a b.png\nelement vertex 5\n"
    uv = "property float s\nproperty float t\n"
    places = ("0 0", "1 0", "1 1", "0 1", "0 0")
    corners = f"{ROWS}0 0 4".split("\n")
    rows = [f"{row} {place}\n" for row, place in zip(corners, places, strict=True)]
    text = f"{head}{XYZ}{uv}element face 2\n{LIST}end_header\n{''.join(rows)}3 0 1 2\n3 0 1 4\n"
    _folder(tmp_path, **{"car/a.ply": text, "car/a b.png": _png()})
    (shape,) = load_folder(tmp_path)["car"]
    assert shape.surfaces[0].texture.shape == (2, 2, 4)
    assert [_uv(shape, corner) for corner in ((0, 0, 0), (2, 3, 0))] == [[0, 0], [1, 1]]


def test_files_of_systems_are_skipped_without_noise(tmp_path: Path) -> None:
    extra = {"car/Thumbs.db": b"\0", "car/desktop.ini": "", "car/.DS_Store": b"\0"}
    _obj(tmp_path, **extra)
    assert [shape.name for shape in load_folder(tmp_path)["car"]] == ["car/a.obj"]


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb"])
def test_too_many_faces_are_refused_before_they_are_read(tmp_path: Path, suffix: str) -> None:
    count = 600_000
    if suffix == "obj":
        content = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * count
    elif suffix == "ply":
        head = f"element vertex 3\n{XYZ}element face {count}\n{LIST}end_header\n"
        content = f"ply\nformat binary_little_endian 1.0\n{head}".encode() + bytes(1_000)
    elif suffix == "stl":
        content = bytes(80) + count.to_bytes(4, "little") + bytes(50 * count)
    else:
        glb = Glb()
        primitive = plain(glb)
        glb.accessors[1]["count"] = 3 * count
        content = glb.bytes(primitive)
    _folder(tmp_path, **{f"car/a.{suffix}": content})
    with pytest.raises(UserError, match=r"600,000 faces, where at most 500,000 .*Decimate"):
        load_folder(tmp_path)
