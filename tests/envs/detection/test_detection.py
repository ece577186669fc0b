"""The detection application: score, purity, a user's own detector and CAD files, bad input."""

import json

import gymnasium as gym
import numpy as np
import pytest
import torch
import trimesh
from families import family
from safetensors.torch import save_file

import sada_gym  # noqa: F401
from sada_gym.envs.checks import MAX_TILE
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.agent.network import Detector
from sada_gym.envs.detection.detector import DETECTOR_TILE
from sada_gym.envs.detection.shapes import CLASSES
from sada_gym.errors import UserError
from sada_gym.oracle import Oracle

CAR = DetectionApplication("car")
RNG = np.random.default_rng(0)
MU = RNG.uniform(-1, 1, (12, 8)).astype(np.float32)
SEEDS = RNG.integers(2**31, size=12).tolist()


def detections(boxes, labels, scores):
    return {
        "boxes": torch.tensor(boxes, dtype=torch.float32).reshape(-1, 4),
        "labels": torch.tensor(labels, dtype=torch.int64),
        "scores": torch.tensor(scores, dtype=torch.float32),
    }


class Constant(torch.nn.Module):
    """A user's detector: says the same of every image and keeps what it was shown."""

    def __init__(self, *answer):
        super().__init__()
        self.answer, self.shown = answer, []
        self.eval()

    def forward(self, images):
        self.shown.append([image.clone() for image in images])
        return [detections(*self.answer) for _ in images]


def test_score_is_the_highest_confidence_in_the_class():
    answer = ([[0, 0, 9, 9]] * 4, [3, 7, 7, 3], [0.2, 0.9, 0.8, 0.5])
    model = Constant(*answer)
    for label, score, fooled in ((3, 0.5, False), (7, 0.9, False), (4, 0.0, True)):
        application = DetectionApplication("car", agent=model, labels={"car": label})
        outcomes = application.evaluate(MU[:1], SEEDS[:1])
        assert outcomes.score[0] == np.float32(score)
        assert outcomes.fooled[0] == fooled


def test_torchvisions_convention_is_kept_towards_the_detector():
    model = Constant([], [], [])
    application = DetectionApplication("car", agent=model, labels={"car": 3}, tile=5)
    application.evaluate(MU[:3], SEEDS[:3])
    first, second, images = model.shown  # the first two: a user's agent is asked twice at first
    assert len(images) == 5
    for asked in zip(first, second, images, strict=True):
        assert all(torch.equal(image, asked[0]) for image in asked)
    assert all(image.shape == (3, 128, 128) and image.dtype == torch.float32 for image in images)
    assert all(image.min() >= 0 and image.max() <= 1 for image in images)
    assert images[0].max() > 0.2
    assert images[3].max() == 0  # padding


def test_info():
    (info,) = CAR.evaluate(MU[:1], SEEDS[:1]).infos
    assert info["shape"].startswith("car/")
    x0, y0, x1, y1 = info["box"]
    assert 0 <= x0 < x1 <= 128
    assert 0 <= y0 < y1 <= 128
    assert set(info["parameters"]) == set(CAR.parameters.names)
    json.dumps(info["detections"])
    best = [d["score"] for d in info["detections"] if d["label"] == CAR.label]
    assert info["score"] == max(best, default=0.0)


def test_the_number_of_threads_does_not_matter():
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        single = CAR.evaluate(MU, SEEDS).score
        torch.set_num_threads(2)
        np.testing.assert_array_equal(CAR.evaluate(MU, SEEDS).score, single)
    finally:
        torch.set_num_threads(threads)


@pytest.mark.slow  # test_registry.py compares with one other process
def test_one_and_two_workers_agree():
    scores = []
    for workers in (1, 2):
        with Oracle("SADA-Detection-Car-v0", budget=16, seed=3, workers=workers) as oracle:
            scores.append(oracle(np.random.default_rng(1).uniform(-1, 1, (16, 8))))
    np.testing.assert_array_equal(*scores)


def test_the_seed_picks_shape_and_place():
    names = {info["shape"] for info in CAR.evaluate(np.zeros((40, 8)), range(40)).infos}
    assert len(names) == 9


def test_every_parameter_changes_the_score():
    seeds = 12
    moved = np.repeat(MU[:1], 8, axis=0)
    for i in range(8):
        moved[i, i] = -moved[i, i] if abs(moved[i, i]) > 0.3 else 0.9
    batch = np.repeat(np.concatenate([MU[:1], moved]), seeds, axis=0)
    before, *after = CAR.evaluate(batch, 9 * [*range(seeds)]).score.reshape(9, seeds)
    for i, score in enumerate(after):
        assert (score != before).mean() > 0.5, i


def test_colour_range_and_pitch_reach_their_ends():
    ends = CAR.parameters.physical(np.array([-np.ones(8), np.ones(8)]))
    np.testing.assert_allclose(ends[0], [8, -180, 0, -180, 3, 0, 0, 0])
    np.testing.assert_allclose(ends[1], [14.5, 180, 51.6, 180, 90, 1, 1, 1])


def test_picture():
    env = gym.make("SADA-Detection-Boat-v0", render_mode="rgb_array")
    env.reset(seed=4)
    before = env.render()
    _, _, _, _, info = env.step(MU[0])
    frame = env.render()
    assert frame.shape == before.shape == (384, 384, 3)
    assert (frame != before).any()
    frames, score = env.unwrapped.replay(MU[0], info["seed"])
    assert score == info["score"]
    np.testing.assert_array_equal(frames[0], frame)


def test_image_size():
    application = DetectionApplication("bus", image_size=192)
    (info,) = application.evaluate(MU[:1], SEEDS[:1]).infos
    assert info["box"][2] > 60
    assert application.settings != DetectionApplication("bus").settings


@pytest.fixture
def cad_folder(tmp_path):
    for name, size in (("car", (4, 1.8, 1.5)), ("lamp", (0.3, 0.3, 2))):
        (tmp_path / name).mkdir()
        trimesh.creation.box(size).export(tmp_path / name / "one.obj")
    (tmp_path / "shapes.json").write_text('{"up": "+z", "front": "+x"}')
    return tmp_path


def test_a_users_cad_files(cad_folder):
    application = DetectionApplication("car", shapes=cad_folder)
    (info,) = application.evaluate(MU[:1], SEEDS[:1]).infos
    assert info["shape"] == "car/one.obj"
    assert application.fingerprint != CAR.fingerprint
    model = Constant([[0, 0, 9, 9]], [1], [0.7])
    lamp = DetectionApplication("lamp", shapes=cad_folder, agent=model, labels={"lamp": 1})
    assert lamp.evaluate(MU[:1], SEEDS[:1]).score[0] == np.float32(0.7)


def test_a_broken_cad_file_is_named_and_left_out_only_on_request(cad_folder):
    (cad_folder / "car" / "broken.obj").write_text("v 0 0 0\n")
    with pytest.raises(ValueError, match=r"broken\.obj"):
        DetectionApplication("car", shapes=cad_folder)
    with pytest.warns(UserWarning, match=r"broken\.obj"):
        application = DetectionApplication("car", shapes=cad_folder, skip_unreadable=True)
    assert [shape.name for shape in application.shapes] == ["car/one.obj"]


def test_fingerprints():
    assert CAR.fingerprint == DetectionApplication("bus").fingerprint
    assert CAR.fingerprint != DetectionApplication("car", agent="surveyor").fingerprint
    labels = {"car": 1}
    function = DetectionApplication("car", agent=Constant([], [], []).forward, labels=labels)
    assert function.fingerprint is None
    named = DetectionApplication("car", agent=len, labels=labels, agent_id="mine-1")
    assert named.fingerprint is not None


def test_a_detector_in_training_mode_is_refused():
    with pytest.raises(ValueError, match=r"in evaluation mode, got Constant.*model\.eval\(\)"):
        DetectionApplication("car", agent=Constant([], [], []).train(), labels={"car": 1})
    partly = Constant([], [], [])
    partly.head = torch.nn.Dropout()
    with pytest.raises(
        ValueError, match=r"got Constant with its part head \(Dropout\) in training"
    ):
        DetectionApplication("car", agent=partly, labels={"car": 1})


@pytest.mark.parametrize(
    ("tile", "one_step", "batch_of_12"),
    [(None, [1], [1] * 12), (5, [5], [5, 5, 5]), (12, [12], [12]), (np.int64(14), [14], [14])],
)
def test_a_users_model_is_shown_its_own_tile(tile, one_step, batch_of_12):
    """By default one image a call: a tile of 14 made a scalar step 14 times as dear."""
    model = Constant([], [], [])
    env = gym.make("SADA-Detection-v0", agent=model, labels={"car": 3}, tile=tile)
    env.reset(seed=0)
    env.step(MU[0])
    assert [len(images) for images in model.shown] == 3 * one_step  # asked twice before it counts
    model.shown.clear()
    env.reset(seed=0)
    env.step(MU[0])
    assert [len(images) for images in model.shown] == one_step
    model.shown.clear()
    env.unwrapped.application.evaluate(MU, SEEDS)
    assert [len(images) for images in model.shown] == batch_of_12
    model.shown.clear()
    envs = gym.make_vec("SADA-Detection-v0", num_envs=12, agent=model, labels={"car": 3}, tile=tile)
    envs.reset(seed=0)
    envs.step(MU)  # asked twice before it counts
    model.shown.clear()
    envs.reset(seed=0)
    envs.step(MU)
    assert [len(images) for images in model.shown] == batch_of_12


def test_the_shipped_architecture_keeps_its_tile(tmp_path):
    file = tmp_path / "mine.safetensors"
    save_file(CAR.agent.state_dict(), file)
    for agent in ("photographer", file, CAR.agent):
        application = DetectionApplication("car", agent=agent)
        assert application.tile == DETECTOR_TILE
        assert application.settings == {
            "object_class": "car",
            "label": 7,
            "image_size": 128,
            "renderer": "Rasteriser",
            "tile": 4,
        }
        assert application.fingerprint == CAR.fingerprint


def test_a_tile_belongs_to_what_a_score_depends_on():
    model, labels = Constant([], [], []), {"car": 3}
    alone, four, shipped = (
        DetectionApplication("car", agent=model, labels=labels, tile=tile) for tile in (None, 4, 14)
    )
    assert [a.settings["tile"] for a in (alone, four, shipped)] == [1, 4, 14]
    assert DetectionApplication("car", tile=1).settings["tile"] == 1


@pytest.mark.parametrize("tile", [0, -1, True, 10**9, MAX_TILE + 1, 2.0, "4"])
def test_a_bad_tile_is_refused(tile):
    with pytest.raises(ValueError, match=rf"tile, .*an int from 1 to 1024, got {tile!r}\."):
        DetectionApplication("car", tile=tile)


def _with(value, name):
    model = Detector(CLASSES).eval()
    with torch.no_grad():
        model.get_parameter(name).view(-1)[3] = value
    return model


class Masked(Constant):
    """Holds infinity where attention masks do."""

    def __init__(self, value):
        super().__init__([], [], [])
        self.register_buffer("mask", torch.tensor([0.0, value]))
        self.register_buffer("count", torch.tensor([1]))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_model_whose_weights_are_no_numbers_is_refused(value):
    """It finds nothing, so that every world would fool it."""
    with pytest.raises(ValueError, match=r"finite numbers, got Detector with NaN or inf.*fine\.0"):
        DetectionApplication("car", agent=_with(value, "fine.0.0.weight"))
    with pytest.raises(ValueError, match=r"NaN or infinity in head\.bias"):
        DetectionApplication(
            "car", agent=_with(value, "head.bias").forward, labels={"car": 7}, agent_id="mine"
        )


def test_a_buffer_may_be_infinite_but_not_nan():
    DetectionApplication("car", agent=Masked(-float("inf")), labels={"car": 3})
    with pytest.raises(ValueError, match="NaN or infinity in mask"):
        DetectionApplication("car", agent=Masked(float("nan")), labels={"car": 3})


def test_unknown_classes_and_labels_are_refused(cad_folder):
    with pytest.raises(ValueError, match=r"one of aeroplane.*got 'cat'.*shapes=PATH"):
        DetectionApplication("cat")
    with pytest.raises(ValueError, match=r"label of 'car'.*none.*labels="):
        DetectionApplication("car", agent=Constant([], [], []))
    with pytest.raises(ValueError, match=r"folder 'bus'.*car, lamp"):
        DetectionApplication("bus", shapes=cad_folder)
    with pytest.raises(ValueError, match=r"image_size of at least 32.*16"):
        DetectionApplication("car", image_size=16)
    with pytest.raises(ValueError, match=r"sides are multiples of 16 pixels .* got 100 x 100"):
        DetectionApplication("car", image_size=100)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda images: [], "Expected 1 dictionaries from the detector, got 0"),
        (lambda images: [{"boxes": 1}] * len(images), "labels, scores from the detector"),
        (
            lambda images: [detections([[0, 0, 9, 9]], [1, 2], [0.1, 0.2])] * len(images),
            r"boxes \(N, 4\).*from the detector, got\s+\(1, 4\)",
        ),
        (
            lambda images: [detections([[0, 0, 9, 9]], [1], [float("nan")])] * len(images),
            r"scores in \[0, 1\] from the detector",
        ),
        (
            lambda images: [detections([[0, 0, 9, 9]], [1], [7.0])] * len(images),
            r"scores in \[0, 1\] from the detector",
        ),
        (
            lambda images: [detections([[0, 0, 9, float("inf")]], [1], [0.5])] * len(images),
            r"boxes of finite numbers from the detector",
        ),
    ],
)
def test_a_detector_that_breaks_the_convention_is_named(answer, message):
    application = DetectionApplication("car", agent=answer, labels={"car": 1})
    with pytest.raises(ValueError, match=message):
        application.evaluate(MU[:1], SEEDS[:1])


def one(boxes, labels, scores):
    return [{"boxes": boxes, "labels": labels, "scores": scores}]


BOX, LABEL, SCORE = torch.tensor([[1.0, 2, 3, 4]]), torch.tensor([1]), torch.tensor([0.5])
NOTHING = torch.zeros(0)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "a list from the detector, got NoneType"),
        ("x", "a list from the detector, got str"),
        (b"x", "a list from the detector, got bytes"),
        (one(BOX, LABEL, SCORE)[0], "a list from the detector, got dict"),
        ((step for step in range(1)), "a list from the detector, got generator"),
        (BOX, "a list from the detector, got Tensor"),
        (one(BOX, LABEL, SCORE) * 2, "Expected 1 dictionaries from the detector, got 2"),
        ([None], "a dictionary from the detector, got NoneType"),
        (["scores"], "a dictionary from the detector, got str"),
        ([{}], "Expected boxes, labels, scores from the detector"),
        (one(None, LABEL, SCORE), "boxes of real numbers .*, got NoneType"),
        (one(BOX, None, SCORE), "labels of real numbers .*, got NoneType"),
        (one(BOX, ["car"], SCORE), "labels of real numbers .*, got list of <U3"),
        (one(BOX, LABEL, torch.tensor([True])), "scores of real numbers .*, got Tensor of bool"),
        (one(BOX, LABEL, torch.tensor([0.5j])), "scores of real numbers .*, got Tensor of complex"),
        (one(BOX, LABEL, torch.tensor(0.5)), r"boxes \(N, 4\).*got .*\(\)"),
        (one(BOX, LABEL[None], SCORE[None]), r"\(1, 4\), \(1, 1\), \(1, 1\)"),
        (one(BOX[0], LABEL, SCORE), r"\(4,\), \(1,\), \(1,\)"),
        (one(BOX[:, :3], LABEL, SCORE), r"\(1, 3\), \(1,\), \(1,\)"),
        (one(NOTHING, LABEL, SCORE), r"\(0,\), \(1,\), \(1,\)"),
        (one([[1, 2], [3]], LABEL, SCORE), "Expected detections from the detector, got ValueError"),
        (one(BOX * torch.nan, LABEL, SCORE), "boxes of finite numbers"),
        (one(BOX, LABEL, SCORE - 1), r"scores in \[0, 1\] .*-0.5"),
        (one(BOX, LABEL, SCORE + 1), r"scores in \[0, 1\] .*1.5"),
        (one(BOX, LABEL, [100]), r"scores in \[0, 1\] .*100"),
        (one(BOX, LABEL + 0.5, SCORE), r"whole labels .*1.5"),
        (one(BOX, LABEL * torch.nan, SCORE), r"whole labels .*nan"),
        (one(BOX, LABEL * torch.inf, SCORE), r"whole labels .*inf"),
        (one(BOX, LABEL, SCORE.to_sparse()), "Expected detections from the detector, got TypeErr"),
        (one(BOX.to("meta"), LABEL, SCORE), "Expected detections from the detector, got NotImpl"),
    ],
)
def test_whatever_a_detector_answers_is_told_as_its_own(answer, message):
    application = DetectionApplication("car", agent=lambda images: answer, labels={"car": 1})
    with pytest.raises(UserError, match=message):
        application.evaluate(MU[:1], SEEDS[:1])


@pytest.mark.parametrize(
    "error", [RuntimeError("a"), KeyError("b"), AssertionError(), MemoryError("c")]
)
def test_whatever_a_detector_raises_is_told_as_its_own(error):
    def raises(images):
        raise error

    application = DetectionApplication("car", agent=raises, labels={"car": 1})
    name = type(error).__name__
    with pytest.raises(UserError, match=f"Expected detections from the detector, got {name}"):
        application.evaluate(MU[:1], SEEDS[:1])


@pytest.mark.parametrize(
    ("answer", "score"),
    [
        (tuple(one(BOX, LABEL, SCORE)), 0.5),
        (one(BOX, LABEL, SCORE.clone().requires_grad_()), 0.5),
        (one(BOX.half(), LABEL.int(), SCORE.bfloat16()), 0.5),
        (one(BOX.double(), LABEL.float(), SCORE.double()), 0.5),
        (one(BOX.numpy(), LABEL.numpy(), SCORE.numpy()), 0.5),
        (one([[1, 2, 3, 4]], [1], [0.5]), 0.5),
        (one(torch.cat([BOX, BOX]), [2, 1], torch.tensor([0, 1], dtype=torch.uint8)), 1.0),
        (one(torch.zeros(25, 4), [2] * 24 + [1], torch.arange(25).div(24).ge(1).byte()), 1.0),
        (one(NOTHING, NOTHING, NOTHING), 0.0),
        (one([], [], []), 0.0),
        (one(torch.zeros(0, 4), NOTHING.long(), NOTHING), 0.0),
        (one([[9, 9, -1e30, 3e38]], [1], [0.5]), 0.5),
    ],
)
def test_the_format_of_a_detectors_numbers_does_not_matter(answer, score):
    application = DetectionApplication("car", agent=lambda images: answer, labels={"car": 1})
    assert application.evaluate(MU[:1], SEEDS[:1]).score[0] == score
    assert application.render(MU[0], 0).dtype == np.uint8


@pytest.mark.parametrize("label", [None, "three", 1.5, float("nan"), True, 2**64, [1]])
def test_labels_that_are_no_whole_numbers_are_refused(label):
    with pytest.raises(UserError, match=r"Expected labels\['car'\] "):
        DetectionApplication("car", agent=lambda images: [], labels={"car": label})


GOLDEN = {
    "aeroplane": [0.48285, 0.64819, 0.40322],
    "bench": [0.77053, 0.35551, 0.63303],
    "bicycle": [0.62359, 0.66982, 0.53876],
    "boat": [0.6689, 0.66211, 0.44893],
    "bottle": [0.83409, 0.58036, 0.46708],
    "bus": [0.88126, 0.31226, 0.58824],
    "car": [0.2714, 0.13772, 0.547],
    "chair": [0.60845, 0.23606, 0.12555],
    "diningtable": [0.77899, 0.42537, 0.43204],
    "motorbike": [0.7543, 0.30633, 0.51485],
    "train": [0.29812, 0.28407, 0.28205],
    "truck": [0.29583, 0.11431, 0.30436],
}
"""Class: scores of the first three rows of MU with SEEDS; guards against silent change."""


@pytest.mark.parametrize("name", family(CLASSES, "car"))
def test_golden_scores(name):
    scores = DetectionApplication(name).evaluate(MU[:3], SEEDS[:3]).score
    np.testing.assert_allclose(scores, GOLDEN[name], atol=2e-3)
