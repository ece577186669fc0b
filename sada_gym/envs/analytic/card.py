"""The card of the analytic application."""

from sada_gym.cards import ApplicationCard, PurityCase, RegistryCase

CARD = ApplicationCard(
    name="SADA-Analytic",
    title="Analytic functions",
    summary="The adversary looks for the boxes in which a function is low; an exact list of them "
    "exists.",
    application="sada_gym.envs.analytic.application:AnalyticApplication",
    case=RegistryCase(purity=PurityCase(70, tuple(range(1, 71)))),
)
