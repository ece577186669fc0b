"""The card of the flight."""

from sada_gym.foundations.cards import ApplicationCard, PackagedAgent, small_suite

_FILES = {
    f"jsbsim/{path}.xml": sha256
    for path, sha256 in (
        (
            "aircraft/c172x/c172x",
            "b736f4b7560d5aab4d2a69026798be1d369b2b2bb5ddcf627aebfd441ba71840",
        ),
        (
            "aircraft/c172x/c172ap",
            "1e83fec37beabf33e1a1bdd7a30fb5d4aeca79ddb52a2dca58a7bcfc1d20e570",
        ),
        ("engine/eng_io320", "0cedc1e356a7a572a175f351a4abb952ba91081219a37dc7192bce3a2181d8c6"),
        ("engine/prop_75in2f", "6481edf1da940fdea5358913d226c3e25d3e6b8209b4805370258a9a65ca7403"),
        ("aircraft/c310/c310", "9db38b94a1359cf529a3c986e0a7746bf8f89f1019660be032667ea7f6613c69"),
        (
            "aircraft/c310/c310ap",
            "dd1cffca8524c2a820afcc7e1108fb934ba22d54a7ce013005fdcc2224839c04",
        ),
        ("engine/engIO470D", "93ea4f9efd5e5ad1b8491615a635836edd7e7e12709157f26faa70df0184d34d"),
        ("engine/propC10v", "4cbd672edefa5b935deb42ee5578b8bd98fe18b78ca6b400f90c8094f14dc432"),
        (
            "aircraft/global5000/global5000",
            "e5b1e5ed68bc3f132b79f1304ad530e922dcc115fd0c692758c4bafe9ed1f43b",
        ),
        (
            "aircraft/global5000/global5000ap",
            "ab83c20d79aa9dd31be403813d169e78d9973b201264fddd7c41eb7f814e24b9",
        ),
        ("engine/BR710", "32d973dfaf579b9051bdaff021deb8d32c3f6cbf2614be10b3191bb0073c7dc2"),
        ("engine/direct", "f116b6f6d25d4b2b46c2f0faa713e85d0064db7a634105bc96e391fb52e4dde5"),
        (
            "systems/GNCUtilities",
            "5ca437aa4a21b6d0c41840b2e367818357336dc1eb3e51fa8bd23104223d0d1c",
        ),
        ("systems/Autopilot", "85e3fa86fff554ad262c1108ddd49a112eb16561a0c349e1f48e26cb0a65c7be"),
    )
}
"""The files of the package on which flights depend, and their SHA-256."""

CARD = ApplicationCard(
    name="SADA-Flight",
    title="Flight",
    summary="The adversary changes an aeroplane's load and speed, the air, ice and the servos, and "
    "the autopilot has to climb and turn as commanded, and to hold altitude and heading.",
    application="sada_gym.envs.flight.application:FlightApplication",
    requirements="sada_gym.envs.flight.application:missing",
    tracks={
        "C172": {"aircraft": "c172"},
        "C310": {"aircraft": "c310"},
        "Global5000": {"aircraft": "global5000"},
    },
    same_as="C172",
    packaged=(
        PackagedAgent(
            name="built-in",
            package="jsbsim",
            version="1.3.3",
            members=_FILES,
            loader="sada_gym.envs.flight.agent.built_in:load",
            summary="the autopilot in the aircraft's own files in JSBSim; the default",
            nominal="holds altitude and heading in all of 200 nominal worlds of each aircraft",
            licence="LGPL-2.1 (the package); the Cessnas' files say GPL",
        ),
    ),
    agent_kind="pilot",
    packages=("jsbsim",),
    reference_points=1_500,
    reference_seeds=2,
    suite=small_suite("flight", tracks=("C310",)),
)
