"""The pixel attack: noise on an image, against the classifier of digits or a user's own."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.pixel.application import PixelApplication

__all__ = ["PixelApplication"]

__getattr__ = lazy_names(__name__, {"PixelApplication": "application"})
