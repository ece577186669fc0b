"""Whether a simulator could compute a world: its state at the end of an episode tells."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from sada_gym.envs.wrapped.factory import function_name
from sada_gym.envs.wrapped.served import ServedEnv
from sada_gym.errors import InvalidWorld, UserTypeError, explained
from sada_gym.foundations.serve_environment import mujoco_fault


def check_valid(env: Any, valid: Callable[[Any], bool | str] | None, name: str) -> None:
    """Raise `InvalidWorld` if the world of an unwrapped environment is not valid at its end."""
    if valid is None:
        reason = env.fault if isinstance(env, ServedEnv) else mujoco_fault(env)
    else:
        called = function_name(valid)
        with explained(f"Expected {called} to judge the world of an episode", "Fix the function."):
            verdict: Any = valid(env)
        if not isinstance(verdict, bool | np.bool_ | str):
            raise UserTypeError(
                f"Expected True, False or a text that says what is wrong from {called}, got "
                f"{verdict!r}."
            )
        reason = verdict if isinstance(verdict, str) else "" if verdict else f"{called} says so"
    if reason:
        raise InvalidWorld(f"Expected {name} to compute its world, but {reason}.", reason)
