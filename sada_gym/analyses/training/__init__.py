"""Training where an agent fails: worlds of attacks, suites and diagnoses in a user's script."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.analyses.training.curriculum import FailureCurriculum
    from sada_gym.analyses.training.lockstep import curriculum_vec_env
    from sada_gym.analyses.training.sources import Source, failures, weaknesses

__all__ = ["FailureCurriculum", "Source", "curriculum_vec_env", "failures", "weaknesses"]

__getattr__ = lazy_names(
    __name__,
    {
        "FailureCurriculum": "curriculum",
        "Source": "sources",
        "curriculum_vec_env": "lockstep",
        "failures": "sources",
        "weaknesses": "sources",
    },
)
