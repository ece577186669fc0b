"""The quadrotor: platforms, rigid-body flight, RAPTOR and the scoring."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.quadrotor.application import QuadrotorApplication

__all__ = ["QuadrotorApplication"]

__getattr__ = lazy_names(__name__, {"QuadrotorApplication": "application"})
