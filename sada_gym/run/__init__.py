"""A run: what an attack leaves in a folder, opened and read in one place."""

from sada_gym.run.run import Run, load_run

__all__ = ["Run", "load_run"]
