"""MetaDrive: its engine, its expert, and drives under attack."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.metadrive.application import MetaDriveApplication
    from sada_gym.envs.metadrive.world.engine import close_engine

__all__ = ["MetaDriveApplication", "close_engine"]

__getattr__ = lazy_names(
    __name__, {"MetaDriveApplication": "application", "close_engine": "world.engine"}
)
