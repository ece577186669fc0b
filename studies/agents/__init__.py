"""Agents of the studies, which the package does not ship; each has a card beside it."""

from pathlib import Path

FOLDER = Path(__file__).parent
