"""The card of photographs."""

from sada_gym.envs.detection.card import CARD as DETECTION
from sada_gym.foundations.cards import ApplicationCard, small_suite

CARD = ApplicationCard(
    name="SADA-Photos",
    title="Photographs",
    summary="The adversary changes camera and weather in photographs of a street, until a "
    "third-party detector no longer finds the people that it found before.",
    application="sada_gym.envs.photos.application:PhotosApplication",
    requirements="sada_gym.envs.photos.application:missing",
    tracks={"Street": {"photos": "street"}},
    same_as="Street",
    fetched=tuple(agent for agent in DETECTION.fetched if agent.name == "coco-centernet"),
    agent_kind="detector",
    packages=("torch", "opencv-python-headless", "opencv-python"),
    reference_points=2_000,
    reference_seeds=2,
    suite=small_suite("photos", "ideal"),
)
