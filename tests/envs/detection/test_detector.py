"""The shipped detectors: convention, weights, what they were measured on."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from sada_gym import agents
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.agent.network import Detector, iou, peaks, unique
from sada_gym.envs.detection.detector import DETECTOR_TILE, DetectorAgent
from sada_gym.envs.detection.shapes import CLASSES
from sada_gym.foundations.cards import cards


@pytest.mark.parametrize("name", agents.names("SADA-Detection"))
def test_torchvisions_convention(name):
    model = agents.load(name, "SADA-Detection")
    detections = model([torch.rand(3, 128, 128), torch.rand(3, 128, 128)])
    assert len(detections) == 2
    for answer in detections:
        count = len(answer["scores"])
        assert answer["boxes"].shape == (count, 4)
        assert answer["labels"].shape == (count,)
        assert answer["labels"].dtype == torch.int64
        assert ((answer["scores"] >= 0) & (answer["scores"] <= 1)).all()
        assert (answer["scores"].diff() <= 0).all()
    assert model.labels == {name: i + 1 for i, name in enumerate(CLASSES)}


def test_the_shipped_weights_are_small_and_pinned():
    for agent in (agent for card in cards() for agent in card.agents):
        assert agent.path.stat().st_size < 10 * 2**20
        agents.verify(agent)
        assert agent.sha256 in agent.path.with_suffix(".md").read_text()
    changed = agents.AgentCard("x", "detection/agent/network.py", "0" * 64, "", "")
    with pytest.raises(ValueError, match=r"SHA-256 0000.*shipped weights were changed"):
        agents.verify(changed)


def test_bad_weights_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"Expected an agent's name.*photograper.*photographer"):
        agents.load("photograper", "SADA-Detection")
    with pytest.raises(ValueError, match="no such file"):
        agents.load(tmp_path / "missing.safetensors", "SADA-Detection")
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(b"not weights")
    with pytest.raises(
        ValueError,
        match=r"Expected the weights of the 12-class Detector in .*broken.*got no safetensors file",
    ):
        agents.load(broken, "SADA-Detection")


def test_fingerprint_follows_the_weights():
    model = Detector(CLASSES)
    before = agents.fingerprint(model)
    assert before == agents.fingerprint(model)
    with torch.no_grad():
        next(model.parameters()).add_(1e-3)
    assert agents.fingerprint(model) != before
    assert agents.fingerprint(len) is None


def test_overlaps():
    a = torch.tensor([[0.0, 0.0, 2.0, 2.0], [0.0, 0.0, 2.0, 2.0], [5.0, 5.0, 6.0, 6.0]])
    b = torch.tensor([[1.0, 0.0, 3.0, 2.0], [0.0, 0.0, 2.0, 2.0], [0.0, 0.0, 1.0, 1.0]])
    np.testing.assert_allclose(iou(a, b), [1 / 3, 1, 0], atol=1e-6)
    boxes = torch.tensor([[0, 0, 4, 4], [0, 0, 4, 5], [0, 0, 4, 4]], dtype=torch.float32)
    boxes, labels = boxes[None].repeat(2, 1, 1), torch.tensor([[1, 1, 2], [1, 1, 1]])
    alive = torch.tensor([[True, True, True], [False, True, True]])
    kept = [[True, False, True], [False, True, False]]
    assert unique(boxes, labels, alive).tolist() == kept


def test_a_double_of_a_double_is_kept():
    """Only detections that are kept themselves suppress others."""
    boxes = torch.tensor([[[0.0, 0, 10, 10], [3, 0, 13, 10], [6, 0, 16, 10]]])
    labels, alive = torch.ones(1, 3), torch.ones(1, 3, dtype=torch.bool)
    assert unique(boxes, labels, alive).tolist() == [[True, False, True]]


def test_peaks_are_those_of_pooling():
    heat = torch.rand(3, 12, 6, 8, generator=torch.Generator().manual_seed(0))
    heat[:, :, :3] = heat[:, :, :3].round(decimals=1)  # with ties
    assert torch.equal(peaks(heat), heat == functional.max_pool2d(heat, 3, 1, 1))


@pytest.fixture(scope="module")
def pictures():
    """Pictures of cars, and one with noise and colours at their ends."""
    application, rng = DetectionApplication("car"), np.random.default_rng(0)
    shown = [application.observation(rng.uniform(-1, 1, 8), seed) for seed in range(12)]
    return [*shown, rng.choice(np.array([0, 255], np.uint8), shown[0].shape)]


def assert_equal(detections, expected):
    for answer, other in zip(detections, expected, strict=True):
        for key in ("boxes", "labels", "scores"):
            np.testing.assert_array_equal(answer[key], other[key])
            assert answer[key].dtype == other[key].dtype


@pytest.mark.parametrize("name", agents.names("SADA-Detection"))
def test_the_folded_network_finds_what_the_network_finds(name, pictures):
    model = agents.load(name, "SADA-Detection")
    folded = DetectorAgent(model).act(pictures)
    plain = DetectorAgent(lambda images: model(images), 4).act(pictures)
    for answer, other in zip(folded, plain, strict=True):
        np.testing.assert_array_equal(answer["labels"], other["labels"])
        np.testing.assert_allclose(answer["scores"], other["scores"], atol=5e-6)
        np.testing.assert_allclose(answer["boxes"], other["boxes"], atol=1e-3)
    assert max(len(answer["scores"]) for answer in folded) > 1


@pytest.mark.parametrize("tile", [DETECTOR_TILE, 1, 5, 16])
def test_neighbours_and_place_in_the_tile_do_not_matter(tile, pictures):
    agent = DetectorAgent(agents.load("surveyor", "SADA-Detection"), tile)
    together = agent.act(pictures)
    assert_equal([agent.act([picture])[0] for picture in pictures], together)
    for shift in range(1, len(pictures)):
        order = np.roll(np.arange(len(pictures)), shift)
        assert_equal(agent.act(pictures, order), [together[i] for i in order])
    assert_equal(agent.act(np.stack(pictures)), together)
    turned = [np.asfortranarray(picture) for picture in pictures]
    assert_equal(agent.act(turned), together)


def test_folding_leaves_the_network_and_its_weights_alone():
    model = agents.load("photographer", "SADA-Detection")
    before, image = model.state_dict(), torch.rand(3, 64, 64)
    before = {name: value.clone() for name, value in before.items()}
    scores = model([image])[0]["scores"]
    agent = DetectorAgent(model)
    assert agent.fingerprint == agents.fingerprint(model)
    assert before.keys() == model.state_dict().keys()
    assert all(torch.equal(model.state_dict()[name], value) for name, value in before.items())
    assert torch.equal(model([image])[0]["scores"], scores)


class Silent(Detector):
    """A user's detector on the shipped layers, which detects otherwise."""

    def forward(self, images):
        return [
            {"boxes": torch.zeros(0, 4), "labels": torch.zeros(0), "scores": torch.zeros(0)}
            for _ in images
        ]


def test_a_subclass_is_called_as_it_is(pictures):
    model = Silent(CLASSES).eval()
    model.load_state_dict(agents.load("photographer", "SADA-Detection").state_dict())
    assert [len(answer["scores"]) for answer in DetectorAgent(model).act(pictures)] == [0] * len(
        pictures
    )


def test_a_detector_keeps_its_floor_and_its_number_of_detections(pictures):
    weights = agents.load("surveyor", "SADA-Detection").state_dict()
    counts = []
    for settings in ({}, {"floor": 0.5}, {"floor": 0.0, "top": 40}, {"top": 1}):
        model = Detector(CLASSES, **settings).eval()
        model.load_state_dict(weights)
        answers = DetectorAgent(model).act(pictures)
        assert all((answer["scores"] >= model.floor).all() for answer in answers)
        counts.append(sum(len(answer["scores"]) for answer in answers))
    assert counts[3] <= len(pictures) < counts[0] < counts[2] <= 20 * len(pictures)
    assert counts[1] < counts[0]


def test_weights_that_give_no_numbers_are_named(pictures):
    model = Detector(CLASSES).eval()
    with torch.no_grad():
        model.fine[0][1].running_var.fill_(-1)  # its root is no number
    message = r"Expected scores in \[0, 1\] from the detector, got \[\[nan"
    with pytest.raises(ValueError, match=message):
        DetectorAgent(model).act(pictures[:1])


@pytest.mark.parametrize("size", [33, 100, 130])
def test_images_whose_sides_are_no_multiples_of_16_are_refused(size):
    model = agents.load("photographer", "SADA-Detection")
    message = rf"sides are multiples of 16 pixels for this detector, got {size} x {size}\. Take 96"
    with pytest.raises(ValueError, match=message):
        DetectorAgent(model, image_size=size)
    with pytest.raises(ValueError, match=message):
        DetectorAgent(model).act([np.zeros((size, size, 3), np.uint8)])
    with pytest.raises(ValueError, match=message):
        model([torch.zeros(3, size, size)])
    DetectorAgent(lambda images: model(images), image_size=size)  # of its sizes nothing is known
