"""Any Gymnasium environment under attack, and the places to which its parameters go."""

from typing import TYPE_CHECKING

from sada_gym.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.wrapped.application import GymnasiumApplication
    from sada_gym.envs.wrapped.disturbances import (
        ActionDelay,
        ActionGain,
        ActionNoise,
        ObservationDelay,
        ObservationDropout,
        ObservationNoise,
        RepeatedActions,
    )
    from sada_gym.envs.wrapped.places import (
        Attribute,
        Config,
        Function,
        Keyword,
        Place,
        ResetOption,
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
    "Place",
    "RepeatedActions",
    "ResetOption",
]

_PLACES = ("Attribute", "Config", "Function", "Keyword", "Place", "ResetOption")

__getattr__ = lazy_names(
    __name__,
    {
        **dict.fromkeys(__all__, "disturbances"),
        **dict.fromkeys(_PLACES, "places"),
        "Episode": "scores",
        "GymnasiumApplication": "application",
    },
)
