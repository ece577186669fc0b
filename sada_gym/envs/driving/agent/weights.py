"""Drivers in files."""

from __future__ import annotations

from sada_gym.agents.shipped_policy import PolicyFiles
from sada_gym.envs.driving.agent.network import BRANCH_FEATURES, ConditionalExtractor, new_model
from sada_gym.envs.driving.episodes import OBSERVATION_SPACE

FILES = PolicyFiles(
    kind="driver",
    trained_by="studies.training.driving.train",
    new_model=new_model,
    observation_space=OBSERVATION_SPACE,
    built={"extractor": ConditionalExtractor.__name__, "branch_features": BRANCH_FEATURES},
)
save, load = FILES.save, FILES.load
