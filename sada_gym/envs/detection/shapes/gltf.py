"""glTF 2.0 (GLB, or JSON with its buffers inside): the triangles of its scene, read strictly."""

from __future__ import annotations

from typing import Any

import numpy as np

from sada_gym.envs.detection.shapes.companions import Companions
from sada_gym.envs.detection.shapes.gltf_file import GltfFile, Json
from sada_gym.envs.detection.shapes.gltf_material import Materials
from sada_gym.envs.detection.shapes.triangles import (
    Indices,
    Points,
    Triangles,
    check_corners,
    check_count,
)
from sada_gym.errors import UserError

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_IDENTITY = np.eye(4)
_LEAST = 4 * np.finfo(float).eps
"""A shorter quaternion turns nothing."""


def read_gltf(content: bytes, companions: Companions | None = None) -> Triangles:
    """Read the triangles of a glTF file's scene; with companions, its materials and textures too.

    Points and lines have no area and are left out. Skins and morph targets are drawn in the pose
    that the file holds; animations are not played.

    Raises:
        UserError: If the file breaks the format, or holds what is not drawn; the message says what.
    """
    file = GltfFile(content, companions)
    world, shown = _places(file)
    check_count(sum(_count(file, file.item("nodes", index)) for index in shown))
    materials = None if companions is None else Materials(file)
    vertices, faces, uv, surface = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], [], []
    start = 0
    for index in shown:
        node = file.item("nodes", index)
        for primitive in _primitives(file, node["mesh"]):
            corners = _faces(file, primitive)
            points, places = _points(file, node, primitive, world), _instances(file, node)
            if "skin" in node and "JOINTS_0" in primitive["attributes"]:
                places = [_IDENTITY]
            else:
                places = [world[index] @ place for place in places]
            for place in places:
                mirrored = np.linalg.det(place[:3, :3]) < 0
                vertices.append(_moved(points, place))
                faces.append((corners[:, ::-1] if mirrored else corners) + start)
                start += len(points)
                if materials is not None:
                    number, own = materials.of(primitive)
                    surface.append(np.full(len(corners), number))
                    own = np.zeros((len(points), 2)) if own is None else own
                    uv.append(own[corners[:, ::-1] if mirrored else corners])
    joined = np.concatenate(faces)
    if materials is None or not surface:
        nothing = np.zeros(len(joined), np.int64)
        return Triangles(np.concatenate(vertices), joined, None, nothing)
    surfaces = materials.surfaces
    return Triangles(
        np.concatenate(vertices), joined, np.concatenate(uv), np.concatenate(surface), surfaces
    )


def _places(file: GltfFile) -> tuple[dict[int, Points], list[int]]:
    """Return the matrix of each node of the scene, and which nodes show a mesh."""
    nodes, scenes = file.items("nodes"), file.items("scenes")
    if scenes:
        roots = file.item("scenes", file.json.get("scene", 0)).get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [index for index in range(len(nodes)) if index not in children]
    world: dict[int, Points] = {}
    shown = []
    waiting = [(root, _IDENTITY, True) for root in roots]
    while waiting:
        index, parent, visible = waiting.pop()
        node = file.item("nodes", index)
        if index in world:
            raise UserError("a node with two parents, or below itself")
        world[index] = parent @ _matrix(node)
        visibility = node.get("extensions", {}).get("KHR_node_visibility", {})
        visible = visible and visibility.get("visible", True)
        if "mesh" in node and visible:
            shown.append(index)
        waiting.extend((child, world[index], visible) for child in node.get("children", []))
    return world, shown


def _matrix(node: Json) -> Points:
    matrix = np.array(node.get("matrix", _IDENTITY.ravel()), float).reshape(4, 4).T
    return matrix @ _placed(
        node.get("translation", (0, 0, 0)),
        node.get("rotation", (0, 0, 0, 1)),
        node.get("scale", (1, 1, 1)),
    )


def _placed(translation: Any, rotation: Any, scale: Any) -> Points:
    x, y, z, w = map(float, rotation)
    matrix, size = np.eye(4), w * w + x * x + y * y + z * z
    if size > _LEAST:
        x, y, z, w = np.array([x, y, z, w]) * np.sqrt(2.0 / size)
        matrix[0, :3] = 1.0 - y * y - z * z, x * y - z * w, x * z + y * w
        matrix[1, :3] = x * y + z * w, 1.0 - x * x - z * z, y * z - x * w
        matrix[2, :3] = x * z - y * w, y * z + x * w, 1.0 - x * x - y * y
    matrix[:3, :3] *= np.asarray(scale, float)
    matrix[:3, 3] = translation
    return matrix


def _moved(points: Points, place: Points) -> Points:
    if not len(points) or np.allclose(place, _IDENTITY, atol=1e-8):
        return points
    return np.asarray((place @ np.column_stack([points, np.ones(len(points))]).T).T[:, :3])


def _instances(file: GltfFile, node: Json) -> list[Points]:
    extension = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
    if extension is None:
        return [_IDENTITY]
    attributes = extension.get("attributes", {})
    arrays = {name: file.array(number) for name, number in attributes.items()}
    count = len(next(iter(arrays.values()))) if arrays else 0
    columns = [
        arrays.get(name, np.tile(plain, (count, 1)))
        for name, plain in (
            ("TRANSLATION", (0, 0, 0)),
            ("ROTATION", (0, 0, 0, 1)),
            ("SCALE", (1, 1, 1)),
        )
    ]
    return [_placed(*row) for row in zip(*columns, strict=True)]


def _primitives(file: GltfFile, mesh: int) -> list[Json]:
    """Return the primitives of a mesh that have faces."""
    primitives = file.item("meshes", mesh)["primitives"]
    for primitive in primitives:
        if primitive.get("mode", _TRIANGLES) not in range(_FAN + 1):
            raise UserError(f"a primitive of mode {primitive['mode']}, which glTF does not have")
    return [
        primitive
        for primitive in primitives
        if primitive.get("mode", _TRIANGLES) >= _TRIANGLES and "POSITION" in primitive["attributes"]
    ]


def _count(file: GltfFile, node: Json) -> int:
    """Count the triangles of a node, before anything is laid out."""
    faces = 0
    for primitive in _primitives(file, node["mesh"]):
        index = primitive.get("indices", primitive["attributes"]["POSITION"])
        corners = file.item("accessors", index)["count"]
        strip = primitive.get("mode", _TRIANGLES) != _TRIANGLES
        faces += max(corners - 2, 0) if strip else corners // 3
    extension = node.get("extensions", {}).get("EXT_mesh_gpu_instancing", {})
    instances = [
        file.item("accessors", number)["count"]
        for number in extension.get("attributes", {}).values()
    ]
    return faces * min(instances, default=1)


def _faces(file: GltfFile, primitive: Json) -> Indices:
    count = file.item("accessors", primitive["attributes"]["POSITION"])["count"]
    if "indices" in primitive:
        values = file.array(primitive["indices"])
        if values.dtype.kind != "u" or values.shape[1] != 1:
            raise UserError("indices that are not unsigned whole numbers")
        corners = values[:, 0].astype(np.int64)
    else:
        corners = np.arange(count)
    check_corners(corners, count)
    mode = primitive.get("mode", _TRIANGLES)
    if mode == _TRIANGLES:
        if len(corners) % 3:
            raise UserError(f"{len(corners):,} corners of triangles, which 3 does not divide")
        return corners.reshape(-1, 3)
    if len(corners) < 3:
        return np.empty((0, 3), np.int64)
    if mode == _FAN:
        first = np.full(len(corners) - 2, corners[0])
        return np.column_stack([first, corners[1:-1], corners[2:]])
    faces = np.column_stack([corners[:-2], corners[1:-1], corners[2:]])
    faces[1::2] = faces[1::2, ::-1]
    return faces


def _points(file: GltfFile, node: Json, primitive: Json, world: dict[int, Points]) -> Points:
    """Return a primitive's positions, (v, 3), with its morph targets and its skin."""
    attributes = primitive["attributes"]
    points = _vectors(file, attributes["POSITION"])
    weights = node.get("weights", file.item("meshes", node["mesh"]).get("weights", []))
    for weight, target in zip(weights, primitive.get("targets", []), strict=False):
        if weight and "POSITION" in target:
            points = points + weight * _vectors(file, target["POSITION"])
    if "skin" not in node or "JOINTS_0" not in attributes:
        return points
    skin = file.item("skins", node["skin"])
    if any(joint not in world for joint in skin["joints"]):
        raise UserError("a skin with joints outside the scene")
    moves = np.array([world[joint] for joint in skin["joints"]])
    if "inverseBindMatrices" in skin:
        inverse = file.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        moves = moves @ inverse[: len(moves)]
    total, moved = np.zeros((len(points), 1)), np.zeros_like(points)
    number = 0
    while f"JOINTS_{number}" in attributes:
        joints = file.array(attributes[f"JOINTS_{number}"]).astype(np.int64)
        shares = file.array(attributes[f"WEIGHTS_{number}"]).astype(float)
        if len(joints) and joints.max() >= len(moves):
            raise UserError("vertices that point at missing joints")
        for joint, share in zip(joints.T, shares.T, strict=True):
            matrix = moves[joint]
            place = np.einsum("vij,vj->vi", matrix[:, :3, :3], points) + matrix[:, :3, 3]
            moved += share[:, None] * place
            total += share[:, None]
        number += 1
    if (total <= 0).any():
        raise UserError("a skin with vertices that follow no joint")
    return np.asarray(moved / total)


def _vectors(file: GltfFile, index: int) -> Points:
    values = file.array(index)
    if values.shape[1] != 3:
        raise UserError("positions that have not three numbers")
    return values.astype(float)
