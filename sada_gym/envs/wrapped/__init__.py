"""Any Gymnasium environment under attack, and what its parameters set."""

from typing import TYPE_CHECKING

from sada_gym.lazy import lazy_names

if TYPE_CHECKING:
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
    from sada_gym.envs.wrapped.scores import Episode

__all__ = [
    "ActionDelay",
    "ActionGain",
    "ActionNoise",
    "Attribute",
    "Config",
    "Episode",
    "Function",
    "GymnasiumApplication",
    "Keyword",
    "ObservationDelay",
    "ObservationDropout",
    "ObservationNoise",
    "ParameterBinding",
    "RepeatedActions",
    "ResetOption",
]

_BINDINGS = ("Attribute", "Config", "Function", "Keyword", "ParameterBinding", "ResetOption")

__getattr__ = lazy_names(
    __name__,
    {
        **dict.fromkeys(__all__, "disturbances"),
        **dict.fromkeys(_BINDINGS, "bindings"),
        "Episode": "scores",
        "GymnasiumApplication": "application",
    },
)
