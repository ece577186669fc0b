"""The card of the analytic application."""

from sada_gym.foundations.cards import ApplicationCard

CARD = ApplicationCard(
    name="SADA-Analytic",
    title="Analytic functions",
    summary="The adversary looks for the boxes in which a function is low; an exact list of them "
    "exists.",
    application="sada_gym.envs.analytic.application:AnalyticApplication",
)
