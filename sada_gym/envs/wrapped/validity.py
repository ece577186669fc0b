"""Whether a simulator could compute a world: its state at the end of an episode tells."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from sada_gym.envs.wrapped.factory import function_name
from sada_gym.errors import InvalidWorld, UserTypeError, explained

_WARNINGS = ("INERTIA", "CONTACTFULL", "CNSTRFULL", "BADQPOS", "BADQVEL", "BADQACC")
"""MuJoCo's warnings of a simulation that went wrong. BADCTRL is the agent's, VGEOMFULL a picture's.

After the last three MuJoCo resets the simulation on its own, and the episode goes on from there.
"""


def check_valid(env: Any, valid: Callable[[Any], bool | str] | None, name: str) -> None:
    """Raise `InvalidWorld` if the world of an unwrapped environment is not valid at its end."""
    if valid is None:
        reason = mujoco_fault(env)
    else:
        called = function_name(valid)
        with explained(f"Expected {called} to judge the world of an episode", "Mend the function."):
            verdict: Any = valid(env)
        if not isinstance(verdict, bool | np.bool_ | str):
            raise UserTypeError(
                f"Expected True, False or a text that says what is wrong from {called}, got "
                f"{verdict!r}."
            )
        reason = verdict if isinstance(verdict, str) else "" if verdict else f"{called} says so"
    if reason:
        raise InvalidWorld(f"Expected {name} to compute its world, but {reason}.", reason)


def mujoco_model(env: Any) -> Any:
    """Return the MuJoCo model of an environment, or None."""
    model: Any = getattr(env, "__dict__", {}).get("model")
    return model if type(model).__module__.partition(".")[0] == "mujoco" else None


def mujoco_fault(env: Any) -> str:
    """Say what went wrong in a MuJoCo simulation; empty where nothing did, or it is another one.

    That is a negative mass or inertia, a timestep that is not positive, or a warning that MuJoCo
    counts: a state that is not finite or too fast, after which it resets itself, a singular inertia
    matrix, or more contacts than fit its memory.
    """
    model, data = mujoco_model(env), getattr(env, "data", None)
    if model is None or data is None or not hasattr(data, "warning"):
        return ""
    import mujoco

    for what in ("body_mass", "body_inertia"):
        if not (getattr(model, what) >= 0.0).all():
            return f"its {what} is negative or NaN"
    if not model.opt.timestep > 0.0:
        return f"its timestep is {model.opt.timestep:g}"
    for warning in _WARNINGS:
        number = int(data.warning[getattr(mujoco.mjtWarning, f"mjWARN_{warning}")].number)
        if number:
            return f"MuJoCo warned of {warning}"
    return ""
