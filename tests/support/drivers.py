"""Drivers for tests: what a model of the driving task becomes."""

from functools import partial

from sada_gym.agents.policy import as_policy
from sada_gym.envs.driving.episodes import DrivingEpisodes

as_driver = partial(as_policy, episodes=DrivingEpisodes)
