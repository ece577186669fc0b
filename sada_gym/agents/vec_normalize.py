"""The `VecNormalize` of an agent's training, read from its file."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

from stable_baselines3.common.vec_env import VecNormalize

from sada_gym.errors import FileError, UserError, UserTypeError, explained


def load_vec_normalize(given: Any, *, allow_pickle: bool) -> VecNormalize:
    """Return a `VecNormalize` as it is, or load the file that its `save` wrote.

    Raises:
        UserError: If it is neither, or the file, a pickle, may not be unpickled.
        FileError: If the file holds something else.
    """
    if isinstance(given, VecNormalize):
        return given
    if not isinstance(given, str | Path):
        raise UserTypeError(
            f"Expected vec_normalize to be a VecNormalize or the path of its file, got {given!r}."
        )
    if not allow_pickle:
        raise UserError(
            f"Expected allow_pickle=True with vec_normalize={str(given)!r}: the file is a pickle, "
            "which can run code when it is loaded. Pass allow_pickle=True if it is your own."
        )
    expected = f"Expected the file of a VecNormalize in {given}"
    with explained(expected, kind=FileError), Path(given).open("rb") as file:
        loaded = pickle.load(file)
    if not isinstance(loaded, VecNormalize):
        raise FileError(f"{expected}, got a {type(loaded).__name__}. Write it by its save.")
    # what its file leaves out, without which it could not be sent to worker processes
    vars(loaded).update(venv=None, class_attributes={}, returns=None)
    return loaded
