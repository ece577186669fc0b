"""Robots in files."""

from __future__ import annotations

from sada_gym.agents.shipped_policy import PolicyFiles
from sada_gym.envs.robot.agent.network import LAYERS, new_model
from sada_gym.envs.robot.episodes import OBSERVATION_SPACE

FILES = PolicyFiles(
    kind="robot",
    trained_by="studies.training.robot.train",
    new_model=new_model,
    observation_space=OBSERVATION_SPACE,
    built={"layers": list(LAYERS)},
)
save, load = FILES.save, FILES.load
