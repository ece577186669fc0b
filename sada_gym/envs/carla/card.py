"""The card of self-driving in CARLA."""

from sada_gym.foundations.cards import ApplicationCard

CARD = ApplicationCard(
    name="SADA-DrivingCarla",
    title="Self-driving in CARLA",
    summary="The adversary mounts the camera and chooses the weather on your CARLA server, "
    "and the driver has to reach its goals.",
    application="sada_gym.envs.carla.application:CarlaDrivingApplication",
    requirements="sada_gym.envs.carla.connection:missing",
    repeatable=False,
    agent_kind="driver",
    packages=("carla", "torch", "stable-baselines3"),
)
