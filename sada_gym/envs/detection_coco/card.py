"""The card of object detection with a detector and models that others made."""

from typing import Any

from sada_gym.envs.detection.card import CARD as DETECTION
from sada_gym.foundations.cards import ApplicationCard, SuiteCard


def _track(object_class: str, *models: str, **keywords: Any) -> dict[str, Any]:
    return {"object_class": object_class, "only": list(models), **keywords}


CARD = ApplicationCard(
    name="SADA-DetectionCoco",
    title="Object detection, COCO",
    summary="The adversary places the camera and the light and paints a textured model, until a "
    "detector that was trained on photographs no longer finds it.",
    application="sada_gym.envs.detection_coco.application:CocoDetectionApplication",
    requirements="sada_gym.envs.detection_coco.application:missing",
    # `studies.coco_classes` chose classes and models by its rule, before any adversary ran
    tracks={
        "Aeroplane": _track("aeroplane", "flightgear/737-300", parameters="unpainted"),
        "Bicycle": _track("bicycle", "sweethome3d/city-bicycle"),
        "Bus": _track("bus", "flightgear/double-decker", parameters="unpainted"),
        "Car": _track(
            *("car", "sweethome3d/ford-focus", "sweethome3d/suv", "sweethome3d/new-beetle"),
        ),
        "Motorbike": _track(
            *("motorbike", "sweethome3d/yamaha-r6", "sweethome3d/scooter", "sweethome3d/vespa"),
        ),
        "Truck": _track("truck", "sweethome3d/lorry"),
    },
    fetched=DETECTION.fetched,
    agent_kind="detector",
    agent_loader=DETECTION.agent_loader,
    packages=DETECTION.packages,
    reference_points=10_000,
    reference_seeds=5,
    suite=SuiteCard(name="detection-coco", tables=("equal-queries",), overview=False),
)
