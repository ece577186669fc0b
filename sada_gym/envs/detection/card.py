"""The card of object detection."""

from sada_gym.cards import AgentCard, ApplicationCard, SuiteCard

_SUFFIXES = (  # in the order of the detectors' labels
    "Aeroplane",
    "Bench",
    "Bicycle",
    "Boat",
    "Bottle",
    "Bus",
    "Car",
    "Chair",
    "DiningTable",
    "Motorbike",
    "Train",
    "Truck",
)

CARD = ApplicationCard(
    name="SADA-Detection",
    title="Object detection",
    summary="The adversary places the camera and the light and paints the object, until the "
    "detector no longer finds it.",
    application="sada_gym.envs.detection.application:DetectionApplication",
    clip="sada_gym.envs.detection.clip:clip",
    tracks={suffix: {"object_class": suffix.lower()} for suffix in _SUFFIXES},
    same_as="Car",
    agents=(
        AgentCard(
            "photographer",
            "detection/agent/photographer.safetensors",
            "026277a23ae6b1f26f9cf7e2f7e0c3851653adf93a48ee622041249cb31d4e0a",
            "detector trained on the views that people photograph; the default",
            "AP50 98.7 % on the views that people photograph",
        ),
        AgentCard(
            "surveyor",
            "detection/agent/surveyor.safetensors",
            "7806ad6c00e2bad10f5d43f287a995b34024205095702575d0cfc09d0e986ab7",
            "the same with one training view in ten from everywhere",
            "AP50 98.5 % on the views that people photograph",
        ),
    ),
    agent_kind="detector",
    agent_loader="sada_gym.envs.detection.agent.weights:load",
    packages=("torch", "trimesh", "numba", "pillow"),
    reference_points=10_000,
    reference_seeds=5,
    suite=SuiteCard(
        name="detection",
        tables=("equal-queries",),
        seeds_of={"Bicycle": 3, "Motorbike": 3, "Truck": 3},
    ),
)
