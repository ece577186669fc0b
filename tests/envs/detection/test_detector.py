"""The shipped detectors: convention, weights, what they were measured on."""

import numpy as np
import pytest
import torch

from sada_gym import agents
from sada_gym.envs.catalogue import cards
from sada_gym.envs.detection.agent.network import Detector, iou, unique
from sada_gym.envs.detection.shapes import CLASSES


@pytest.mark.parametrize("name", agents.names("SADA-Detection"))
def test_torchvisions_convention(name):
    model = agents.load(name, "SADA-Detection")
    found = model([torch.rand(3, 128, 128), torch.rand(3, 128, 128)])
    assert len(found) == 2
    for one in found:
        count = len(one["scores"])
        assert one["boxes"].shape == (count, 4)
        assert one["labels"].shape == (count,)
        assert one["labels"].dtype == torch.int64
        assert ((one["scores"] >= 0) & (one["scores"] <= 1)).all()
        assert (one["scores"].diff() <= 0).all()
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
    assert unique(boxes, labels, alive) == [[0, 2], [1]]
