"""Pilots: a network that sees where the next gate is, and a reinforcement learner."""
