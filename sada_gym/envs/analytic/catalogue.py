"""The card of the analytic application."""

from sada_gym.cards import ApplicationCard, PurityCase, RegistryCase

CARD = ApplicationCard(
    name="SADA-Analytic",
    application="sada_gym.envs.analytic.application:AnalyticApplication",
    case=RegistryCase(purity=PurityCase(70, tuple(range(1, 71)))),
)
