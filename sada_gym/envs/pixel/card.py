"""The card of the pixel attack."""

from dataclasses import replace

from sada_gym.envs.digits.card import CNN, LOADER
from sada_gym.foundations.cards import ApplicationCard

CARD = ApplicationCard(
    name="SADA-Pixel",
    title="Pixel attack",
    summary="The adversary adds noise to the image of a digit, and the classifier has to read it.",
    application="sada_gym.envs.pixel.application:PixelApplication",
    agents=(replace(CNN, summary="the classifier of SADA-Digits; the default"),),
    agent_kind="classifier",
    agent_loader=LOADER,
    packages=("scikit-learn", "torch"),
)
