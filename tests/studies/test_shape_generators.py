"""The generators of shapes: styles and seeds, the file of the benchmark, the modelling kit."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from sada_gym.envs.detection.shapes import CLASSES, benchmark_shapes, catalogue, fingerprint
from studies.shapes import kit
from studies.shapes.build import write
from studies.shapes.catalogue import BENCHMARK_COUNT, TRAINING_SEED, generate, styles
from studies.shapes.polygon import offset_inwards, triangulate

pytestmark = pytest.mark.slow


ROUNDING = 1e-12
"""The file was made on a processor with AVX-512, whose arccos rounds otherwise: by 1e-15 here."""


@pytest.mark.parametrize("object_class", CLASSES)
def test_the_benchmark_is_what_the_generators_give(object_class: str) -> None:
    made = [generate(object_class, seed) for seed in range(BENCHMARK_COUNT[object_class])]
    for shape, stored in zip(made, benchmark_shapes(object_class), strict=True):
        for name, value in shape.to_dict().items():
            other = getattr(stored, name)
            assert type(other) is type(value)
            if isinstance(value, np.ndarray):
                assert (other.dtype, other.shape) == (value.dtype, value.shape)
                assert other.flags.c_contiguous
                assert not other.flags.writeable
                np.testing.assert_allclose(other, value, rtol=0, atol=ROUNDING)
            else:
                assert other == value


def test_the_file_is_written_as_the_package_has_it(tmp_path: Path) -> None:
    write(tmp_path / "benchmark.npz")
    assert hashlib.sha256(catalogue.FILE.read_bytes()).hexdigest() == catalogue.SHA256
    with np.load(tmp_path / "benchmark.npz") as made, np.load(catalogue.FILE) as stored:
        assert made.files == stored.files
        for name in made.files:
            if made[name].dtype.kind == "f":
                np.testing.assert_allclose(made[name], stored[name], rtol=0, atol=ROUNDING)
            else:
                np.testing.assert_array_equal(made[name], stored[name])


@pytest.mark.parametrize("object_class", CLASSES)
def test_every_style_is_in_the_benchmark(object_class: str) -> None:
    names = styles(object_class)
    assert len(names) >= 4
    families = {
        shape.name.split("/")[1].rsplit("-", 1)[0] for shape in benchmark_shapes(object_class)
    }
    assert families == set(names)


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


def test_unknown_class_and_negative_seed_are_refused() -> None:
    with pytest.raises(ValueError, match=r"one of aeroplane, .*, got 'cow'; choose one of these"):
        generate("cow", 0)
    with pytest.raises(ValueError, match=r"seed of at least 0, got -1"):
        generate("car", -1)
