"""The card of the toy."""

from sada_gym.foundations.cards import ApplicationCard, SuiteCard

CARD = ApplicationCard(
    name="SADA-Toy",
    title="Toy slopes",
    summary="The adversary tilts the slopes, and the ball has to roll.",
    application="sada_gym.envs.toy_application.application:ToyApplication",
    tracks={"Two": {"slopes": 2}, "Three": {"slopes": 3}},
    same_as="Two",
    suite=SuiteCard(name="toys", tables=("equal-queries",), seeds=2, images=0),
)
