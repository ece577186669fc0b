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
from sada_gym.envs.wrapped.camera import CameraFault
from sada_gym.envs.wrapped.disturbances import (
    ActionDelay,
    ActionGain,
    ActionNoise,
    ObservationBias,
    ObservationDelay,
    ObservationDrift,
    ObservationDropout,
    ObservationNoise,
    RepeatedActions,
)
from sada_gym.envs.wrapped.events import ActuatorFailure, Event, RealTime, SensorFailure
from sada_gym.envs.wrapped.forces import Force, Push, Wind
from sada_gym.envs.wrapped.scores import Episode
from sada_gym.envs.wrapped.stress import StressEnv
from sada_gym.foundations.serve_environment import mujoco_fault

__all__ = [
    "ActionDelay",
    "ActionGain",
    "ActionNoise",
    "ActuatorFailure",
    "Attribute",
    "CameraFault",
    "Config",
    "Episode",
    "Event",
    "Force",
    "Function",
    "GymnasiumApplication",
    "Keyword",
    "ObservationBias",
    "ObservationDelay",
    "ObservationDrift",
    "ObservationDropout",
    "ObservationNoise",
    "ParameterBinding",
    "Push",
    "RealTime",
    "RepeatedActions",
    "ResetOption",
    "SensorFailure",
    "StressEnv",
    "Wind",
    "mujoco_fault",
]
