"""What all tests share."""

from __future__ import annotations

import pytest

import sada_gym  # noqa: F401 - registers the environments

pytest.register_assert_rewrite("sada_gym.testing")
