"""Gymnasium environments, adversaries and metrics for finding out how trained agents fail.

Importing the package registers its environments with Gymnasium and loads no simulator, no network
and no weights.
"""

from typing import TYPE_CHECKING

from sada_gym import arithmetic as arithmetic  # first: it chooses kernels before NumPy loads
from sada_gym.application import Application, Outcomes, Scored
from sada_gym.evaluation.problems import make_application
from sada_gym.frames import Frame
from sada_gym.lazy import lazy_names
from sada_gym.parameters import Parameter, ParameterSpace
from sada_gym.registration import env_ids, register_environments, tracks

if TYPE_CHECKING:
    from sada_gym.agents.remote.server import serve
    from sada_gym.behaviour import Behaviour
    from sada_gym.envs.wrapped.application import GymnasiumApplication

__version__ = "0.1.0"

__all__ = [
    "Application",
    "Behaviour",
    "Frame",
    "GymnasiumApplication",
    "Outcomes",
    "Parameter",
    "ParameterSpace",
    "Scored",
    "__version__",
    "env_ids",
    "make_application",
    "register_environments",
    "serve",
    "tracks",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Behaviour": "behaviour",
        "GymnasiumApplication": "envs.wrapped.application",
        "serve": "agents.remote.server",
    },
)

register_environments()
