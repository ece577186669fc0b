"""Any Gymnasium environment under attack, and what its parameters set."""

from sada_gym.envs.wrapped.application import GymnasiumApplication
from sada_gym.envs.wrapped.bindings import (
    Attribute,
    Config,
    Function,
    Keyword,
    ParameterBinding,
    ResetOption,
)
from sada_gym.envs.wrapped.disturbances import (
    ActionDelay,
    ActionGain,
    ActionNoise,
    ObservationDelay,
    ObservationDropout,
    ObservationNoise,
    RepeatedActions,
)
from sada_gym.envs.wrapped.forces import Force, Push, Wind
from sada_gym.envs.wrapped.scores import Episode
from sada_gym.foundations.serve_environment import mujoco_fault

__all__ = [
    "ActionDelay",
    "ActionGain",
    "ActionNoise",
    "Attribute",
    "Config",
    "Episode",
    "Force",
    "Function",
    "GymnasiumApplication",
    "Keyword",
    "ObservationDelay",
    "ObservationDropout",
    "ObservationNoise",
    "ParameterBinding",
    "Push",
    "RepeatedActions",
    "ResetOption",
    "Wind",
    "mujoco_fault",
]
