"""The procedural shapes: conventions of every class, determinism, and the modelling kit."""

import numpy as np
import pytest

from sada_gym.envs.detection.shapes import (
    CLASSES,
    DIAGONAL,
    TRAINING_SEED,
    Material,
    Shape,
    benchmark_shapes,
    fingerprint,
    generate,
    kit,
    styles,
)
from sada_gym.envs.detection.shapes.assembly import assemble
from sada_gym.envs.detection.shapes.polygon import offset_inwards, triangulate

MAX_FACES = 2_500


def _samples(object_class: str) -> list[Shape]:
    training = [generate(object_class, TRAINING_SEED + seed) for seed in range(12)]
    return [*benchmark_shapes(object_class), *training]


def _corners(shape: Shape) -> np.ndarray:
    return shape.vertices[shape.faces].astype(float)


def _areas(shape: Shape) -> np.ndarray:
    corners = _corners(shape)
    edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.linalg.norm(edges, axis=1) / 2


@pytest.mark.parametrize("object_class", CLASSES)
def test_conventions(object_class: str) -> None:
    for shape in _samples(object_class):
        assert shape.object_class == object_class
        assert shape.name.startswith(f"{object_class}/")
        assert (shape.vertices.dtype, shape.normals.dtype) == (np.float32, np.float32)
        assert (shape.faces.dtype, shape.materials.dtype) == (np.int32, np.uint8)
        assert np.isfinite(shape.vertices).all()
        assert np.isfinite(shape.normals).all()
        low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
        np.testing.assert_allclose(np.linalg.norm(high - low), DIAGONAL, rtol=1e-4)
        np.testing.assert_allclose((low + high)[:2], 0.0, atol=1e-4)
        np.testing.assert_allclose(low[2], 0.0, atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=1), 1.0, atol=1e-4)
        assert shape.height == pytest.approx(high[2])
        assert 50 <= len(shape.faces) <= MAX_FACES, shape.name
        assert len(shape.materials) == len(shape.faces)
        assert set(shape.materials.tolist()) <= set(Material)
        assert shape.faces.min() >= 0
        assert shape.faces.max() == len(shape.vertices) - 1
        assert (_areas(shape) > 0).all()


@pytest.mark.parametrize("object_class", CLASSES)
def test_normals_agree_with_windings_and_point_outward(object_class: str) -> None:
    for shape in _samples(object_class):
        corners = _corners(shape)
        faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        cosine = np.einsum("fi,fki->fk", faces, shape.normals[shape.faces])
        assert (cosine > 0).mean() > 0.99, shape.name
        # Parts are closed, so that the volume they enclose is positive where they face outward, and
        # seen from outside its bounding box an object shows front sides only.
        volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum()
        assert volume > 0, shape.name
        assert _front_sides_first(shape) > 0.95, shape.name


def _front_sides_first(shape: Shape) -> float:
    """Gives the share of rays from outside whose first hit is a face's front side."""
    rng = np.random.default_rng(0)
    corners = _corners(shape)
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(ab, ac)
    hits = 0
    front = 0
    target = corners[rng.integers(len(corners), size=60)].mean(axis=1)
    direction = rng.normal(size=(60, 3))
    direction[:, 2] = -np.abs(direction[:, 2])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for start, ray in zip(target - 20 * direction, direction, strict=True):
        towards = normal @ ray
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.einsum("fi,fi->f", a - start, normal) / towards
            offset = start + distance[:, None] * ray - a
            u = np.einsum("fi,fi->f", np.cross(offset, ac), normal)
            v = np.einsum("fi,fi->f", np.cross(ab, offset), normal)
            size = (normal**2).sum(axis=1)
            inside = (u >= 0) & (v >= 0) & (u + v <= size) & np.isfinite(distance)
        if inside.any():
            hits += 1
            front += towards[inside][np.argmin(distance[inside])] < 0
    assert hits > 30
    return front / hits


@pytest.mark.parametrize("object_class", CLASSES)
def test_paint_covers_enough_for_its_colour_to_matter(object_class: str) -> None:
    for shape in _samples(object_class):
        areas = _areas(shape)
        share = areas[shape.materials == Material.PAINT].sum() / areas.sum()
        assert share > 0.35, (shape.name, share)


def test_benchmark_is_100_different_shapes() -> None:
    shapes = [shape for object_class in CLASSES for shape in benchmark_shapes(object_class)]
    assert len(shapes) == 100
    assert len({shape.name for shape in shapes}) == 100
    assert len({shape.vertices.tobytes() for shape in shapes}) == 100


@pytest.mark.parametrize("object_class", CLASSES)
def test_every_style_is_in_the_benchmark(object_class: str) -> None:
    names = styles(object_class)
    assert len(names) >= 4
    found = {shape.name.split("/")[1].rsplit("-", 1)[0] for shape in benchmark_shapes(object_class)}
    assert found == set(names)


@pytest.mark.parametrize("object_class", CLASSES)
def test_same_seed_same_bytes_and_other_seed_other_shape(object_class: str) -> None:
    again = generate.__wrapped__
    cycle = len(styles(object_class))
    for seed in (0, 3, TRAINING_SEED + 1):
        assert fingerprint([again(object_class, seed)]) == fingerprint(
            [generate(object_class, seed)]
        )
        same_style = generate(object_class, seed + cycle)
        assert generate(object_class, seed).vertices.tobytes() != same_style.vertices.tobytes()
        following = generate(object_class, seed + 1)
        assert generate(object_class, seed).vertices.tobytes() != following.vertices.tobytes()


@pytest.mark.parametrize("object_class", CLASSES)
def test_training_and_benchmark_share_no_shape(object_class: str) -> None:
    benchmark = {shape.vertices.tobytes() for shape in benchmark_shapes(object_class)}
    training = {
        generate(object_class, TRAINING_SEED + seed).vertices.tobytes() for seed in range(20)
    }
    assert len(training) == 20
    assert not benchmark & training


def test_cached_shapes_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        generate("chair", 0).vertices[0, 0] = 1.0


def test_unknown_class_is_refused() -> None:
    with pytest.raises(ValueError, match=r"one of aeroplane, .*, got 'cow'; choose one of these"):
        generate("cow", 0)
    with pytest.raises(ValueError, match="got 'cow'"):
        benchmark_shapes("cow")
    with pytest.raises(ValueError, match=r"seed of at least 0, got -1"):
        generate("car", -1)


CONCAVE = [(0, 0), (3, 0), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2)]

SOLIDS = {
    "box": (kit.box((1, 2, 3), (4, 5, 6)), 6.0),
    "tapered box": (kit.box((2, 2, 3), (0, 0, 0), taper=(0.0, 0.0), shift=(1, 0)), 4.0),
    "cylinder": (kit.cylinder((0, 0, 0), (0, 0, 2), 1.0, segments=64), 2 * np.pi),
    "cone": (kit.cylinder((0, 0, 0), (3, 0, 0), 1.0, 0.0, segments=64), np.pi),
    "tube": (kit.tube([(0, 0, 0), (1, 0, 0), (2, 0, 0)], 0.5, segments=64), np.pi / 2),
    "lathe": (kit.lathe([(1, 0), (1, 2)], axis="y", segments=64), 2 * np.pi),
    "extruded": (kit.extrude(CONCAVE, 2.0), 10.0),
    "extruded clockwise": (kit.extrude(CONCAVE[::-1], 2.0), 10.0),
    "slab": (kit.slab([(0, 0, 0), (2, 0, 0), (0, 0, 2)], 0.1), 0.2),
    "loft": (kit.loft([kit.ring((x, 0, 0), 1, 1, segments=64) for x in (0, 1)]), np.pi),
    "ellipsoid": (kit.ellipsoid((1, 2, 3), (1, 1, 1), segments=48, rings=32), 8 * np.pi),
    "torus": (
        kit.torus((0, 0, 0), (0, 1, 0), 2, 0.5, segments=64, tube_segments=32),
        np.pi**2,
    ),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_are_closed_and_of_the_right_volume(name: str) -> None:
    part, volume = SOLIDS[name]
    for image in (part, kit.mirrored(part), kit.turned(part, "x", 30, about=(1, 2, 3))):
        mesh = image.mesh.copy()
        mesh.merge_vertices()
        mesh.update_faces(mesh.nondegenerate_faces())
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume == pytest.approx(volume, rel=0.02)


def test_chamfer_and_bevel_cut_the_edges() -> None:
    sharp = kit.box((1, 1, 1), (0, 0, 0)).mesh.volume
    assert 0.9 * sharp < kit.box((1, 1, 1), (0, 0, 0), chamfer=0.1).mesh.volume < sharp
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    assert 0.9 < kit.extrude(square, 1.0, bevel=0.1).mesh.volume < 1.0
    np.testing.assert_allclose(
        offset_inwards(np.array(square, float), 0.1),
        [(0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.1, 0.9)],
    )


@pytest.mark.parametrize(
    ("axis", "point", "expected"),
    [("x", (0, 1, 0), (0, 0, 1)), ("y", (0, 0, 1), (1, 0, 0)), ("z", (1, 0, 0), (0, 1, 0))],
)
def test_turned_follows_the_right_hand_rule(axis: str, point: tuple, expected: tuple) -> None:
    part = kit.turned(kit.box((0.1, 0.1, 0.1), point), axis, 90)
    np.testing.assert_allclose(part.mesh.centroid, expected, atol=1e-9)


def test_both_sides_adds_mirror_images() -> None:
    left, right = kit.both_sides(kit.box((1, 1, 1), (0, 3, 0)))
    np.testing.assert_allclose(left.mesh.centroid, (0, 3, 0))
    np.testing.assert_allclose(right.mesh.centroid, (0, -3, 0))
    assert right.mesh.volume > 0


def test_triangulation_covers_concave_polygons() -> None:
    ring = np.column_stack([np.array(CONCAVE, float), np.zeros(len(CONCAVE))])
    faces = triangulate(ring)
    assert len(faces) == len(CONCAVE) - 2
    a, b, c = ring[faces].transpose(1, 0, 2)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(5.0)


def test_sharp_edges_double_vertices_and_round_ones_do_not() -> None:
    cube = assemble("a", "b", [kit.box((1, 1, 1), (0, 0, 0))])
    assert len(cube.vertices) == 24
    ball = assemble("a", "b", [kit.ellipsoid((1, 1, 1), (0, 0, 0), segments=16, rings=8)])
    assert len(ball.vertices) == 7 * 16 + 2
    centre = np.array([0, 0, ball.height / 2])
    outward = (ball.vertices - centre) / np.linalg.norm(ball.vertices - centre, axis=1)[:, None]
    assert np.einsum("vi,vi->v", outward, ball.normals).min() > 0.99


def test_inside_out_parts_are_turned() -> None:
    part = kit.box((1, 2, 3), (0, 0, 0))
    wrong = part.mesh.copy()
    wrong.invert()
    a, b = (assemble("a", "b", [p]) for p in (part, kit.Part(wrong)))
    for shape in (a, b):
        corners = _corners(shape)
        assert np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0


def test_parts_without_area_are_refused() -> None:
    flat = kit.Part(kit.scaled(kit.box((1, 1, 1), (0, 0, 0)), 0.0).mesh)
    with pytest.raises(ValueError, match="Expected thing to have a face with area, got none"):
        assemble("thing", "car", [flat])
