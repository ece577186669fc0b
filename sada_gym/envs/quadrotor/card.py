"""The card of the quadrotor."""

from sada_gym.foundations.cards import ApplicationCard, PackagedAgent, small_suite

CARD = ApplicationCard(
    name="SADA-Quadrotor",
    title="Quadrotor",
    summary="The adversary changes a quadrotor's build and motors, its load, the wind, what its "
    "sensors tell and how fast it has to fly, and the pilot has to follow a figure of eight.",
    application="sada_gym.envs.quadrotor.application:QuadrotorApplication",
    requirements="sada_gym.envs.quadrotor.application:missing",
    tracks={"Crazyflie": {"platform": "crazyflie"}, "X500": {"platform": "x500"}},
    same_as="Crazyflie",
    packaged=(
        PackagedAgent(
            name="raptor",
            package="foundation-policy",
            version="1.0.2",
            members={
                "foundation_policy/blob/checkpoint.h5": (
                    "db11f14ca2a8547f646d9baa57ccceaaff00b1be1c751b632641f514972355c5"
                )
            },
            loader="sada_gym.envs.quadrotor.agent.raptor:load",
            summary="RAPTOR, one recurrent policy for quadrotors of 20 g to 5 kg, which PX4 has, "
            "too; the default",
            nominal="follows the figure in all of 200 nominal worlds",
            licence="MIT",
        ),
    ),
    agent_kind="pilot",
    packages=("foundation-policy", "h5py", "numba"),
    reference_points=10_000,
    reference_seeds=4,
    suite=small_suite("quadrotor"),
)
