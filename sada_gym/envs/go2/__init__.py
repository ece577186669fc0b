"""The Go2: a robot dog in MuJoCo, the ground, the walk and its scoring."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.go2.application import Go2Application

__all__ = ["Go2Application"]

__getattr__ = lazy_names(__name__, {"Go2Application": "application"})
