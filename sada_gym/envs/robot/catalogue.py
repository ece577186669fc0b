"""The card of the robot."""

from sada_gym.envs.catalogue import AgentCard, ApplicationCard, PurityCase, RegistryCase

CARD = ApplicationCard(
    name="SADA-Robot",
    application="sada_gym.envs.robot.application:RobotApplication",
    tracks={"Warehouse": {}},
    same_as="Warehouse",
    agents=(
        AgentCard(
            "ppo",
            "robot/agent/ppo.safetensors",
            "",
            "learnt by PPO in the middle of all ranges; the default",
        ),
        AgentCard(
            "ppo-randomised",
            "robot/agent/ppo-randomised.safetensors",
            "",
            "the same, with conditions from the middle quarter of each range",
        ),
    ),
    agent_kind="robot",
    agent_loader="sada_gym.envs.robot.agent.weights:load",
    tasks={
        "SADA-RobotTask-v0": (
            "sada_gym.envs.robot.task:RobotTaskEnv",
            "sada_gym.envs.robot.task:RobotTaskVectorEnv",
        )
    },
    packages=("torch", "stable-baselines3", "pymunk", "numba"),
    reference_points=4_000,
    reference_seeds=4,
    case=RegistryCase(slow=True, purity=PurityCase(4, (3,))),
)
