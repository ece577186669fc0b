"""Gymnasium environments, adversaries and metrics for finding out how trained agents fail.

Importing the package registers its environments with Gymnasium and loads no simulator, no network
and no weights.
"""

from sada_gym.application import Application, Frame, Outcomes, Scored
from sada_gym.parameters import Parameter, ParameterSpace
from sada_gym.registration import env_ids, make_application, register_environments, tracks

__version__ = "0.1.0"

__all__ = [
    "Application",
    "Frame",
    "Outcomes",
    "Parameter",
    "ParameterSpace",
    "Scored",
    "__version__",
    "env_ids",
    "make_application",
    "register_environments",
    "tracks",
]

register_environments()
