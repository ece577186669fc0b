"""The card of MetaDrive."""

from sada_gym.foundations.cards import AgentCard, ApplicationCard, PackagedAgent, small_suite

_PACKAGE, _VERSION, _LICENCE = "metadrive-simulator", "0.4.3", "Apache-2.0"

CARD = ApplicationCard(
    name="SADA-DrivingMetaDrive",
    title="MetaDrive",
    summary="The adversary changes road, traffic, accidents, lidar and car, and a third-party "
    "driver has to follow its route without a crash.",
    application="sada_gym.envs.metadrive.application:MetaDriveApplication",
    requirements="sada_gym.envs.metadrive.world.engine:missing",
    packaged=(
        PackagedAgent(
            name="metadrive-expert",
            package=_PACKAGE,
            version=_VERSION,
            members={
                "metadrive/examples/ppo_expert/expert_weights.npz": (
                    "ed66fed9ecfbe7c1acd18a9d95c659119892dcc773758f40849c3390c6f38eaf"
                )
            },
            loader="sada_gym.envs.metadrive.agent.expert:load",
            summary="MetaDrive's own PPO expert; the default",
            nominal="arrives in 96 % of nominal worlds",
            licence=_LICENCE,
        ),
        PackagedAgent(
            name="metadrive-idm",
            package=_PACKAGE,
            version=_VERSION,
            members={
                "metadrive/policy/idm_policy.py": (
                    "46e184f7c2c510ccec75f4ed81bd824be3226787c86140749714e71c00a4989d"
                )
            },
            loader="sada_gym.envs.metadrive.agent.idm:load",
            summary="the rule-based driver that moves MetaDrive's traffic",
            nominal="arrives in 18 of 20 nominal worlds",
            licence=_LICENCE,
        ),
    ),
    agents=(
        AgentCard(
            "metadrive-ppo",
            "metadrive/agent/metadrive-ppo.safetensors",
            "5840a15b18b2be7a1c62bade5dde709f825907c0ef05bedd636067000efadc93",
            "ours: imitates the expert, then trained on by PPO",
            "arrives in 100 of 100 nominal worlds",
        ),
    ),
    agent_kind="driver",
    agent_loader="sada_gym.envs.metadrive.agent.network:load",
    tasks={
        "SADA-DrivingMetaDriveTask-v0": (
            "sada_gym.envs.metadrive.task:DriveTaskEnv",
            "sada_gym.envs.metadrive.task:DriveTaskVectorEnv",
        )
    },
    packages=(_PACKAGE, "torch", "stable-baselines3", "numba"),
    reference_points=1_500,
    reference_seeds=2,
    suite=small_suite("metadrive"),
)
