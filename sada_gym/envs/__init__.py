"""The environments: an application each, and what makes any application a Gymnasium environment."""

from sada_gym.envs.adversary import AdversaryEnv, AdversaryVectorEnv

__all__ = ["AdversaryEnv", "AdversaryVectorEnv"]
