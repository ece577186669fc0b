"""Agents that drive in MetaDrive."""
