"""How detectors are trained and measured, a few steps of it."""

import numpy as np
import pytest
import torch

from sada_gym import agents
from sada_gym.envs.detection.agent.network import Detector
from sada_gym.envs.detection.renderers import Renderer, Rendering
from sada_gym.envs.detection.shapes import CLASSES, benchmark_shapes
from studies.shapes.catalogue import TRAINING_SEED
from studies.training.detection.data import (
    TRAINING_SHAPES,
    VALIDATION_SHAPES,
    LabelledFrames,
    batches,
    training_frames,
    validation_frames,
)
from studies.training.detection.evaluate import average_precision, calibration_error, detect
from studies.training.detection.prior import photograph, survey
from studies.training.detection.recipe import DetectorRecipe
from studies.training.detection.train import detection_loss, giou, targets, train

pytestmark = pytest.mark.slow  # goldens and reference sets guard what is shipped


def frames(images, boxes, labels):
    return LabelledFrames(
        np.asarray(images, np.uint8), np.asarray(boxes, np.float32), np.asarray(labels)
    )


@pytest.fixture(scope="module")
def known():
    """Frames as photographers take them."""
    return validation_frames(12, photograph, image_size=128, seed=5)


@pytest.mark.parametrize("name", agents.names("SADA-Detection"))
def test_the_shipped_detectors_know_the_prior(name, known):
    """A small part of the model card's measurement; the card has 240 frames a class."""
    detections = detect(agents.load(name, "SADA-Detection"), known.images)
    precision = [average_precision(detections, known, k + 1) for k in range(len(CLASSES))]
    assert np.mean(precision) > 0.9
    assert calibration_error(detections, known) < 0.25


def test_training_validation_and_benchmark_shapes_are_apart():
    assert min(TRAINING_SHAPES) >= TRAINING_SEED
    assert not set(TRAINING_SHAPES) & set(VALIDATION_SHAPES)
    names = {shape.name for name in CLASSES for shape in benchmark_shapes(name)}
    assert len(names) == 100
    assert all(int(name.rsplit("-", 1)[1]) < TRAINING_SEED for name in names)


def test_average_precision_of_known_cases():
    truth = frames(np.zeros((3, 8, 8, 3)), [[0, 0, 4, 4]] * 3, [1, 1, 2])

    def found(box, label, score):
        return {
            "boxes": torch.tensor([box], dtype=torch.float32),
            "labels": torch.tensor([label]),
            "scores": torch.tensor([score]),
        }

    hit, miss = [0, 0, 4, 4], [4, 4, 8, 8]
    assert average_precision([found(hit, 1, 0.9)] * 2 + [found(hit, 2, 0.5)], truth, 1) == 1
    # a confident false alarm on another class's frame halves the precision at every recall
    mixed = [found(hit, 1, 0.8), found(miss, 1, 0.7), found(hit, 1, 0.9)]
    assert average_precision(mixed, truth, 1) == pytest.approx(0.5 * 0.5)
    assert average_precision([found(miss, 1, 0.9)] * 3, truth, 1) == 0


def test_generalised_overlaps():
    a = torch.tensor([[0.0, 0.0, 2.0, 2.0], [0.0, 0.0, 2.0, 2.0], [5.0, 5.0, 6.0, 6.0]])
    b = torch.tensor([[1.0, 0.0, 3.0, 2.0], [0.0, 0.0, 2.0, 2.0], [0.0, 0.0, 1.0, 1.0]])
    np.testing.assert_allclose(giou(a, b), [1 / 3, 1, -34 / 36], atol=1e-6)


def test_targets_peak_at_the_centre():
    heat, centre = targets(
        frames(np.zeros((2, 64, 64, 3)), [[8, 16, 40, 32], [0] * 4], [3, 0]), (4, 8, 8)
    )
    assert heat[0, 2, 3, 3] == 1
    assert (heat >= 1).sum() == 1
    assert centre[1].max() == 0


def test_mirrored_batches_keep_the_box_on_the_object():
    images = np.zeros((4, 32, 32, 3), np.uint8)
    images[:, 10:14, 4:9] = 255
    data = frames(images, [[4, 10, 9, 14]] * 4, [1] * 4)
    seen = set()
    for batch in (next(batches(data, 4, np.random.default_rng(s))) for s in range(4)):
        for image, box in zip(batch.images, batch.boxes, strict=True):
            columns = np.flatnonzero(image[12, :, 0] > 128)
            assert (columns.min(), columns.max() + 1) == (box[0], box[2])
            seen.add(float(box[0]))
    assert seen == {4.0, 23.0}


def test_the_samplers_draw_what_they_say():
    rng = np.random.default_rng(0)
    people = [photograph(None, rng) for _ in range(400)]
    assert max(s.camera_pitch_deg for s in people) <= 30
    assert min(s.light_pitch_deg for s in people) >= 12
    assert np.mean([abs(s.camera_azimuth_deg) < 120 for s in people]) > 0.85
    everywhere = [survey(None, rng) for _ in range(400)]
    assert max(s.camera_pitch_deg for s in everywhere) > 48
    assert np.mean([abs(s.camera_azimuth_deg) > 90 for s in everywhere]) == pytest.approx(
        0.5, abs=0.1
    )


def test_a_few_steps_of_training_lower_the_loss_and_repeat(tmp_path):
    """The training script, a few steps: two equal runs, a falling loss, weights that load again."""
    recipe = DetectorRecipe(survey_share=0.5, per_class=2, epochs=6, batch=12, image_size=64)
    first, second = (train(recipe, 7, checkpoint=tmp_path / "w.safetensors") for _ in range(2))
    for a, b in zip(first.state_dict().values(), second.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    known = validation_frames(2, photograph, image_size=64, seed=0)
    torch.manual_seed(7)  # the training began with these weights
    fresh = Detector(CLASSES).eval()
    with torch.no_grad():
        assert detection_loss(first, known) < detection_loss(fresh, known)
    again = agents.load(tmp_path / "w.safetensors", "SADA-Detection")
    assert torch.equal(again.head.weight, first.head.weight)


class Grey(Renderer):
    """A renderer whose pictures are all alike."""

    def __init__(self):
        self.scenes = []

    def render_batch(self, scenes, image_size):
        self.scenes.append(list(scenes))
        image = np.full((image_size, image_size, 3), 77, np.uint8)
        return [Rendering(image, np.zeros(image.shape[:2], bool), None) for _ in scenes]


def test_training_data_is_rendered_by_the_same_interface():
    renderer = Grey()
    keywords = {"survey_share": 0.5, "empty_share": 0.1, "image_size": 32, "seed": 0}
    frames = training_frames(8, **keywords, renderer=renderer)
    assert (frames.images == 77).all()
    assert not frames.labels.any()
    assert [len(scenes) for scenes in renderer.scenes] == [64, len(frames.images) - 64]
    frames = validation_frames(1, photograph, image_size=32, seed=0, renderer=renderer)
    assert (frames.images == 77).all()
