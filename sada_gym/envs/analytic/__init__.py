"""The analytic application: an instant landscape whose fooling set is known exactly."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.analytic.application import AnalyticApplication

__all__ = ["AnalyticApplication"]

__getattr__ = lazy_names(__name__, {"AnalyticApplication": "application"})
