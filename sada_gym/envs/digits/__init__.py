"""Digits under attack: the images, their warps, the classifier and its scoring."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.digits.application import DigitsApplication

__all__ = ["DigitsApplication"]

__getattr__ = lazy_names(__name__, {"DigitsApplication": "application"})
