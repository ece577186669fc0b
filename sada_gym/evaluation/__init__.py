"""Evaluating mu: the oracle that adversaries query, the store of scores, the workers."""
