"""The adversaries by name. Importing this loads none of them, and no torch."""

from sada_gym.adversaries.base import Adversary, Query
from sada_gym.adversaries.registry import (
    Description,
    describe,
    find,
    make,
    missing_package,
    names,
    resolve,
)

__all__ = [
    "Adversary",
    "Description",
    "Query",
    "describe",
    "find",
    "make",
    "missing_package",
    "names",
    "resolve",
]
