"""Detectors of torchvision's, chosen by a name: with a stub, for torchvision may not be here."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch

from sada_gym import agents, make_application
from sada_gym.errors import MissingExtra, UserError

CATEGORIES = ["__background__", "person", "N/A", "motorcycle", "car", "dining table"]


class Finder(torch.nn.Module):
    """Finds a car at a corner, with the mean colour as its score, from its random weights on."""

    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.rand(1))

    def forward(self, images):
        assert not self.training
        box = torch.tensor([[0.0, 0.0, 9.0, 9.0]])
        return [
            {"boxes": box, "labels": torch.tensor([4]), "scores": image.mean()[None]}
            for image in images
        ]


@pytest.fixture
def asked(monkeypatch):
    """The names and weights of which a stub of torchvision has made models."""
    made = []
    package, models = ModuleType("torchvision"), ModuleType("torchvision.models")
    detection = ModuleType("torchvision.models.detection")
    best = SimpleNamespace(meta={"categories": CATEGORIES})

    def get_model(name, weights):
        made.append((name, weights))
        if name == "offline":
            raise OSError("no route to host")
        return Finder()

    models.list_models = lambda module: ["finder", "offline"] if module is detection else []
    models.get_model_weights = lambda name: SimpleNamespace(DEFAULT=best)
    models.get_model = get_model
    models.detection, package.models = detection, models
    for module in (package, models, detection):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    made.append(best)
    return made


def test_it_takes_the_best_weights_and_their_categories(asked):
    model = agents.load("torchvision:finder", "SADA-Detection")
    assert asked[1:] == [("finder", asked[0])]
    assert model.labels == {
        **{"person": 1, "motorcycle": 3, "car": 4, "dining table": 5},
        **{"motorbike": 3, "diningtable": 5},
    }
    assert not any(parameter.requires_grad for parameter in model.parameters())


def test_on_a_track(asked):
    name = "torchvision:finder"
    application = make_application("SADA-Detection-Car-v0", agent=name)
    assert (application.agent_name, application.label) == (name, 4)
    outcomes = application.evaluate(np.zeros((2, 8)), [0, 1])
    assert (outcomes.score > 0).all()
    assert application.fingerprint is not None
    with pytest.raises(UserError, match="Expected the detector's label of 'bus'"):
        make_application("SADA-Detection-Bus-v0", agent=name)


def test_other_names_and_a_missing_network_are_sentences(asked):
    agents.check_agent("torchvision:finder", "SADA-Detection")
    with pytest.raises(UserError, match=r"detector of torchvision .*'findr'.*Did you mean finder"):
        agents.load("torchvision:findr", "SADA-Detection")
    with pytest.raises(UserError, match=r"get the weights of offline, got OSError: no route"):
        agents.load("torchvision:offline", "SADA-Detection")
    with pytest.raises(UserError, match="Expected an agent's name among cil"):
        agents.load("torchvision:finder", "SADA-Driving")
    with pytest.raises(UserError, match="Expected an agent's name among photographer"):
        agents.load("torch:finder", "SADA-Detection")


def test_a_missing_torchvision_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torchvision", None)
    with pytest.raises(
        MissingExtra, match=r"'torchvision:ssdlite320\w*', got none\. .*pip install"
    ):
        agents.load("torchvision:ssdlite320_mobilenet_v3_large", "SADA-Detection")


def test_a_torchvision_that_does_not_fit_says_so(monkeypatch):
    class Broken:
        def find_spec(self, name, path=None, target=None):
            if name == "torchvision":
                raise RuntimeError("operator torchvision::nms does not exist")

    monkeypatch.delitem(sys.modules, "torchvision", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Broken(), *sys.meta_path])
    with pytest.raises(UserError, match=r"nms does not exist\. Install the torchvision that fits"):
        agents.load("torchvision:ssdlite320_mobilenet_v3_large", "SADA-Detection")
