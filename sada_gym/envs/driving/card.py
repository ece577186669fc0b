"""The card of self-driving."""

from sada_gym.foundations.cards import AgentCard, ApplicationCard, SuiteCard

CARD = ApplicationCard(
    name="SADA-Driving",
    title="Self-driving",
    summary="The adversary mounts the camera and chooses the weather, and the driver has to stay "
    "on the road.",
    application="sada_gym.envs.driving.application:DrivingApplication",
    tracks={
        "Straight": {"task": "straight"},
        "OneCurve": {"task": "one_curve"},
        "Navigation": {"task": "navigation"},
    },
    same_as="Navigation",
    agents=(
        AgentCard(
            "cil",
            "driving/agent/cil.safetensors",
            "42cc4cf97217ce4ba45a4315cedf835677ed0f97d7653f5d901a60872ee40372",
            "imitates an expert, at the default camera in four weathers; the default",
            "arrives in 600 of 600 drives",
        ),
        AgentCard(
            "cil-augmented",
            "driving/agent/cil-augmented.safetensors",
            "932d7d9d92d97d4e3e96acf907896cc4a96d0fbaaf6b893b986a65734ee1433c",
            "the same, with another camera each drive and stronger changes of the light",
            "arrives in 600 of 600 drives",
        ),
        AgentCard(
            "ppo",
            "driving/agent/ppo.safetensors",
            "22e413aaaf7937a60be0d14f717f7c1f8a882cbdcf66d5bb7a1827f1432f6fa4",
            "cil, trained on by PPO on the driving task",
            "arrives in 599 of 600 drives",
        ),
    ),
    agent_kind="driver",
    agent_loader="sada_gym.envs.driving.agent.network:load",
    tasks={
        "SADA-DrivingTask-v0": (
            "sada_gym.envs.driving.task:DrivingTaskEnv",
            "sada_gym.envs.driving.task:DrivingTaskVectorEnv",
        )
    },
    packages=("torch", "stable-baselines3", "highway-env", "numba", "pillow"),
    suite=SuiteCard(name="driving", seeds=3, images=0),
)
