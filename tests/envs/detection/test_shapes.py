"""The benchmark's shapes, their conventions, and how parts become a shape."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import trimesh

from sada_gym.envs.detection.shapes import (
    CLASSES,
    DIAGONAL,
    Material,
    Shape,
    benchmark_shapes,
    catalogue,
    fingerprint,
)
from sada_gym.envs.detection.shapes.assembly import Part, assemble
from studies.shapes import kit
from studies.shapes.catalogue import TRAINING_SEED, generate

MAX_FACES = 2_500

shapes_of_all_classes = pytest.mark.parametrize(
    ("object_class", "seeds"),
    [(name, None) for name in CLASSES]
    + [
        pytest.param(name, range(TRAINING_SEED, TRAINING_SEED + 12), marks=pytest.mark.slow)
        for name in CLASSES
    ],
    ids=[f"{name}-{kind}" for kind in ("benchmark", "training") for name in CLASSES],
)


def _samples(object_class: str, seeds: range | None) -> Sequence[Shape]:
    if seeds is None:
        return benchmark_shapes(object_class)
    return [generate(object_class, seed) for seed in seeds]


def _corners(shape: Shape) -> np.ndarray:
    return shape.vertices[shape.faces].astype(float)


def _areas(shape: Shape) -> np.ndarray:
    corners = _corners(shape)
    edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.linalg.norm(edges, axis=1) / 2


@shapes_of_all_classes
def test_conventions(object_class: str, seeds: range | None) -> None:
    for shape in _samples(object_class, seeds):
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


@shapes_of_all_classes
def test_normals_agree_with_windings_and_point_outward(
    object_class: str, seeds: range | None
) -> None:
    for shape in _samples(object_class, seeds):
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


@shapes_of_all_classes
def test_paint_covers_enough_for_its_colour_to_matter(
    object_class: str, seeds: range | None
) -> None:
    for shape in _samples(object_class, seeds):
        areas = _areas(shape)
        share = areas[shape.materials == Material.PAINT].sum() / areas.sum()
        assert share > 0.35, (shape.name, share)


def test_benchmark_is_100_different_shapes() -> None:
    shapes = [shape for object_class in CLASSES for shape in benchmark_shapes(object_class)]
    assert len(shapes) == 100
    assert len({shape.name for shape in shapes}) == 100
    assert len({shape.vertices.tobytes() for shape in shapes}) == 100


def test_shapes_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        benchmark_shapes("chair")[0].vertices[0, 0] = 1.0


def test_unknown_class_is_refused() -> None:
    with pytest.raises(ValueError, match=r"one of aeroplane, .*, got 'cow'; choose one of these"):
        benchmark_shapes("cow")


def test_a_missing_or_changed_file_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = benchmark_shapes.__wrapped__
    monkeypatch.setattr(catalogue, "FILE", tmp_path / "benchmark.npz")
    with pytest.raises(ValueError, match=r"Expected the benchmark's shapes in .*no such file"):
        fresh("car")
    (tmp_path / "benchmark.npz").write_bytes(b"shapes")
    message = rf"Expected benchmark\.npz with SHA-256 {catalogue.SHA256[:12]}\.\.\., got .*changed"
    with pytest.raises(ValueError, match=message):
        fresh("car")


def test_the_shapes_are_those_that_the_benchmark_was_measured_on() -> None:
    assert fingerprint(shape for name in CLASSES for shape in benchmark_shapes(name)) == (
        "44fcf4c25a969db28b2c307a6ae8d2fe9c7f8141e785067ee2dc37502682939c"
    )


def test_sharp_edges_double_vertices_and_round_ones_do_not() -> None:
    cube = assemble("a", "b", [Part(trimesh.creation.box((1, 1, 1)))])
    assert len(cube.vertices) == 24
    ball = assemble("a", "b", [kit.ellipsoid((1, 1, 1), (0, 0, 0), segments=16, rings=8)])
    assert len(ball.vertices) == 7 * 16 + 2
    centre = np.array([0, 0, ball.height / 2])
    outward = (ball.vertices - centre) / np.linalg.norm(ball.vertices - centre, axis=1)[:, None]
    assert np.einsum("vi,vi->v", outward, ball.normals).min() > 0.99


def test_inside_out_parts_are_turned() -> None:
    part = Part(trimesh.creation.box((1, 2, 3)))
    wrong = part.mesh.copy()
    wrong.invert()
    a, b = (assemble("a", "b", [p]) for p in (part, Part(wrong)))
    for shape in (a, b):
        corners = _corners(shape)
        assert np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0


def test_parts_without_area_are_refused() -> None:
    flat = kit.scaled(Part(trimesh.creation.box((1, 1, 1))), 0.0)
    with pytest.raises(ValueError, match="Expected thing to have a face with area, got none"):
        assemble("thing", "car", [flat])
