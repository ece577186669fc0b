"""Object detection: the world, its renderer, its scoring."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.detection.application import DetectionApplication

__all__ = ["DetectionApplication"]

__getattr__ = lazy_names(__name__, {"DetectionApplication": "application"})
