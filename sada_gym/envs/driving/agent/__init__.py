"""Drivers: an expert's imitators and a reinforcement learner, held in SB3 policies."""
