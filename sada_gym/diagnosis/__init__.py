"""The diagnosis: the few rules over physical parameters that say how an agent fails."""

from typing import TYPE_CHECKING

from sada_gym.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.diagnosis.run import diagnose

__all__ = ["diagnose"]

__getattr__ = lazy_names(__name__, {"diagnose": "run"})
