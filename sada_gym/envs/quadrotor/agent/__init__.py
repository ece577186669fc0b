"""RAPTOR, the quadrotor's agent."""
