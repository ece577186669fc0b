"""The card of UAV racing."""

from sada_gym.foundations.cards import AgentCard, ApplicationCard, SuiteCard

CARD = ApplicationCard(
    name="SADA-UAV",
    title="UAV racing",
    summary="The adversary bends the race track by its anchors, and the pilot has to pass every "
    "gate.",
    application="sada_gym.envs.uav.application:UAVApplication",
    tracks={f"{anchors}Anchors": {"anchors": anchors} for anchors in (3, 4, 5)},
    same_as="3Anchors",
    agents=(
        AgentCard(
            "ppo",
            "uav/agent/ppo.safetensors",
            "9505502b163f7a09492f2ac64386f314c65f897d4d4e824f0cd64d82bcf99b0a",
            "gets the places of the next two gates and no image; learnt to fly by PPO; the default",
            "passes 96.5 to 100 % of the gates",
        ),
        AgentCard(
            "waypoint-pid",
            "uav/agent/waypoint-pid.safetensors",
            "ee7c8c5cb21ce57d9c8f03f0f3d51ecabf61891e3a770006925e0042e6df0b57",
            "sees where the next gate is and flies there; trained on mild tracks",
            "passes 99.6 to 100 % of the gates",
        ),
    ),
    agent_kind="pilot",
    agent_loader="sada_gym.envs.uav.agent.network:load",
    tasks={
        "SADA-RacingTask-v0": (
            "sada_gym.envs.uav.task:RacingTaskEnv",
            "sada_gym.envs.uav.task:RacingTaskVectorEnv",
        )
    },
    packages=("torch", "stable-baselines3", "pybullet", "numba"),
    reference_points=5_000,
    reference_seeds=5,
    suite=SuiteCard(name="racing", seeds=3, images=0),
)
