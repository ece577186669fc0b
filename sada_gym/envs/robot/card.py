"""The card of the robot."""

from sada_gym.foundations.cards import AgentCard, ApplicationCard, SuiteCard

CARD = ApplicationCard(
    name="SADA-Robot",
    title="Robot navigation",
    summary="The adversary changes the warehouse, the load, the lidar and the wheels, and the "
    "robot has to reach its goal.",
    application="sada_gym.envs.robot.application:RobotApplication",
    tracks={"Warehouse": {}},
    same_as="Warehouse",
    agents=(
        AgentCard(
            "ppo",
            "robot/agent/ppo.safetensors",
            "8dee89ea877872d41012d9877e60439e48416d115faee92f7954d7557c3e730e",
            "learnt by PPO in the middle of all ranges; the default",
            "reaches 98.3 % of the goals",
        ),
        AgentCard(
            "ppo-randomised",
            "robot/agent/ppo-randomised.safetensors",
            "d30329e60700267ffa8ac57d8f181cf37a01a84c1d98d329376c8e59bfc2a08e",
            "the same, with conditions from the middle quarter of each range",
            "reaches 98.2 % of the goals",
        ),
    ),
    agent_kind="robot",
    agent_loader="sada_gym.envs.robot.agent.network:load",
    tasks={
        "SADA-RobotTask-v0": (
            "sada_gym.envs.robot.task:RobotTaskEnv",
            "sada_gym.envs.robot.task:RobotTaskVectorEnv",
        )
    },
    packages=("torch", "stable-baselines3", "pymunk", "numba"),
    reference_points=4_000,
    reference_seeds=4,
    suite=SuiteCard(name="robot", seeds=3, images=0),
)
