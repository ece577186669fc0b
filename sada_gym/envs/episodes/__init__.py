"""Closed loops: episodes in lockstep, an agent that acts in them, and inner tasks made of them."""
