"""`torchvision:NAME`: a model of torchvision's, with weights that torchvision gets."""

from __future__ import annotations

from typing import Any

from sada_gym.envs.detection.agent.coco import with_our_names
from sada_gym.errors import MissingExtra, UserError, check_known, explained


def load(name: str) -> Any:
    """Load one of torchvision's detectors with its best weights, see `load_any`."""
    return load_any(name, detectors_only=True)[0]


def load_any(name: str, *, detectors_only: bool = False) -> tuple[Any, bool]:
    """Load one of torchvision's models with its best weights; say whether it is a detector.

    torchvision downloads the weights on first use. The model's `labels` are the categories of the
    weights, and our classes' names where COCO has another one.

    Raises:
        UserError: If torchvision is missing, does not fit the installed torch, has no model of that
            name, or cannot get its weights.
    """
    expected = f"Expected torchvision for the agent 'torchvision:{name}'"
    fix = "Install the torchvision that fits this torch: pip install torchvision."
    try:
        with explained(expected, fix):
            from torchvision import models
            from torchvision.models import detection
    except UserError as error:
        if isinstance(error.__cause__, ModuleNotFoundError):
            raise MissingExtra(f"{expected}, got none. {fix}") from error
        raise
    detectors = models.list_models(module=detection)
    others = [] if detectors_only else models.list_models(module=models)
    what = "detector" if detectors_only else "model"
    check_known(f"{what} of torchvision", [name], [*detectors, *others])
    weights = models.get_model_weights(name).DEFAULT
    fix = "Connect to the internet for the first use, or put the file where torchvision looks."
    with explained(f"Expected torchvision to get the weights of {name}", fix):
        model = models.get_model(name, weights=weights)
    unused = ("__background__", "N/A")
    categories = enumerate(weights.meta["categories"])
    model.labels = with_our_names({each: i for i, each in categories if each not in unused})
    return model.eval().requires_grad_(False), name in detectors
