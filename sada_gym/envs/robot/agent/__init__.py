"""Robots: the shipped policy, and a planner that knows everything."""
