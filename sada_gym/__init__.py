"""Gymnasium environments, adversaries and metrics for finding out how trained agents fail.

Importing the package registers its environments with Gymnasium and loads no simulator, no network
and no weights.
"""

from typing import TYPE_CHECKING

# first: it chooses kernels before NumPy loads
from sada_gym.foundations import arithmetic as _arithmetic  # isort: skip  # noqa: F401

from sada_gym.application import Application, Outcomes, Scored
from sada_gym.evaluation.problems import make_application
from sada_gym.foundations.frames import Frame
from sada_gym.foundations.lazy import lazy_names
from sada_gym.foundations.registration import env_ids, register_environments, tracks
from sada_gym.parameters import Parameter, ParameterSpace

if TYPE_CHECKING:
    from sada_gym.adversaries.base import Adversary
    from sada_gym.agents.remote.server import serve
    from sada_gym.analyses.diagnose import diagnose
    from sada_gym.analyses.estimation.estimate import estimate
    from sada_gym.analyses.recording import record
    from sada_gym.analyses.regression.export import export
    from sada_gym.analyses.regression.regress import regress
    from sada_gym.analyses.replay import replay
    from sada_gym.analyses.report.make import report
    from sada_gym.analyses.rescore import rescore, transfer
    from sada_gym.analyses.training import FailureCurriculum, curriculum_vec_env
    from sada_gym.attacks import attack
    from sada_gym.envs.images.application import ImageApplication
    from sada_gym.envs.wrapped.application import GymnasiumApplication
    from sada_gym.envs.wrapped.stress import StressEnv
    from sada_gym.evaluation.executors import Workers
    from sada_gym.evaluation.oracle import Oracle
    from sada_gym.foundations.behaviour import Behaviour
    from sada_gym.foundations.serve_environment import serve_environment
    from sada_gym.run import Run, load_run

__version__ = "0.1.0"

__all__ = [
    "Adversary",
    "Application",
    "Behaviour",
    "FailureCurriculum",
    "Frame",
    "GymnasiumApplication",
    "ImageApplication",
    "Oracle",
    "Outcomes",
    "Parameter",
    "ParameterSpace",
    "Run",
    "Scored",
    "StressEnv",
    "Workers",
    "__version__",
    "attack",
    "curriculum_vec_env",
    "diagnose",
    "env_ids",
    "estimate",
    "export",
    "load_run",
    "make_application",
    "record",
    "register_environments",
    "regress",
    "replay",
    "report",
    "rescore",
    "serve",
    "serve_environment",
    "tracks",
    "transfer",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Adversary": "adversaries.base",
        "Behaviour": "foundations.behaviour",
        "FailureCurriculum": "analyses.training",
        "GymnasiumApplication": "envs.wrapped.application",
        "StressEnv": "envs.wrapped.stress",
        "ImageApplication": "envs.images.application",
        "Oracle": "evaluation.oracle",
        "Run": "run",
        "Workers": "evaluation.executors",
        "attack": "attacks",
        "curriculum_vec_env": "analyses.training",
        "diagnose": "analyses.diagnose",
        "estimate": "analyses.estimation.estimate",
        "export": "analyses.regression.export",
        "load_run": "run",
        "record": "analyses.recording",
        "regress": "analyses.regression.regress",
        "replay": "analyses.replay",
        "report": "analyses.report.make",
        "rescore": "analyses.rescore",
        "serve": "agents.remote.server",
        "serve_environment": "foundations.serve_environment",
        "transfer": "analyses.rescore",
    },
)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


register_environments()
