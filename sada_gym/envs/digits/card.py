"""The card of the digits."""

from sada_gym.foundations.cards import AgentCard, ApplicationCard, SuiteCard

CNN = AgentCard(
    "cnn",
    "digits/agent/cnn.safetensors",
    "20310308027458ca18818a87c2c3b8d3bb544d0b454c2f36779d18bae9bfa9cc",
    "a small CNN, trained on 1,352 real digits; the default",
    "reads 98.9 % of the test images",
)
LOADER = "sada_gym.envs.digits.agent.network:load"

CARD = ApplicationCard(
    name="SADA-Digits",
    title="Handwritten digits",
    summary="The adversary warps images of handwritten digits, and the classifier has to read "
    "them.",
    application="sada_gym.envs.digits.application:DigitsApplication",
    tracks={str(digit): {"digit": digit} for digit in range(10)},
    agents=(CNN,),
    agent_kind="classifier",
    agent_loader=LOADER,
    packages=("scikit-learn", "torch"),
    reference_points=20_000,
    reference_seeds=8,
    # with the Sobol seed 0, `bayesian` with the seed 0 would begin its search at the same points
    sobol_seed=2020,
    suite=SuiteCard(name="digits", seeds=3, images=0),
)
