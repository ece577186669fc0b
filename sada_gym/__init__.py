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
    from sada_gym.adversaries.base import Adversary
    from sada_gym.agents.remote.server import serve
    from sada_gym.analyses.diagnose import diagnose
    from sada_gym.attacks import attack
    from sada_gym.behaviour import Behaviour
    from sada_gym.envs.wrapped.application import GymnasiumApplication
    from sada_gym.evaluation.oracle import Oracle
    from sada_gym.run import Run, load_run

__version__ = "0.1.0"

__all__ = [
    "Adversary",
    "Application",
    "Behaviour",
    "Frame",
    "GymnasiumApplication",
    "Oracle",
    "Outcomes",
    "Parameter",
    "ParameterSpace",
    "Run",
    "Scored",
    "__version__",
    "attack",
    "diagnose",
    "env_ids",
    "load_run",
    "make_application",
    "register_environments",
    "serve",
    "tracks",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Adversary": "adversaries.base",
        "Behaviour": "behaviour",
        "GymnasiumApplication": "envs.wrapped.application",
        "Oracle": "evaluation.oracle",
        "Run": "run",
        "attack": "attacks",
        "diagnose": "analyses.diagnose",
        "load_run": "run",
        "serve": "agents.remote.server",
    },
)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


register_environments()
