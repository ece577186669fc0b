"""Files of agents: SB3's zips, ONNX, TorchScript."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from gymnasium import spaces

from sada_gym.errors import FileError, UserError
from sada_gym.foundations.cards import fetchable
from sada_gym.foundations.lazy import load

ONNX = (".onnx",)
TORCHSCRIPT = (".pt", ".pth", ".ts", ".torchscript", ".jit")
SUFFIXES = (".zip", *ONNX, *TORCHSCRIPT)
"""How the names of agents' files end, in small letters."""

_READ_FIRST = 4_096


def find_agent_file(given: str | Path) -> Path:
    """Return an agent's file: `~` is the home folder, and SB3's `.zip` may be left out.

    Raises:
        FileError: If there is no such file.
    """
    path = Path(os.path.expanduser(given))
    zipped = path.with_name(f"{path.name}.zip") if path.name else path
    for file in (path, zipped):
        if os.path.isfile(file):
            return file
    raise FileError(f"Expected an SB3 zip as the agent, got {path}: no such file. Check its path.")


def names_model(given: str) -> bool:
    """Say whether a text names a model of images: a fetched one, or one of torchvision's."""
    return given in fetchable() or given.startswith("torchvision:")


def load_agent_file(
    path: Path,
    observation_space: spaces.Space[Any],
    action_space: spaces.Space[Any],
    *,
    allow_pickle: bool,
    has_statistics: bool,
    environment: str = "",
) -> Any:
    """Load the agent in a file for an environment of these spaces.

    Args:
        path: The file; its ending says what it is.
        observation_space: The environment's observations.
        action_space: The environment's actions.
        allow_pickle: Whether an SB3 zip may be unpickled.
        has_statistics: Whether it is known by which statistics observations are normalised.
        environment: The environment's id: RL Zoo keeps statistics in a folder of that name.

    Raises:
        UserError: If it is no such file, for other spaces, or statistics lie beside a zip.
    """
    suffix = path.suffix.lower()
    if suffix in ONNX:
        return load("sada_gym.agents.exported:OnnxNetwork")(path, observation_space, action_space)
    if suffix in TORCHSCRIPT:
        network = load("sada_gym.agents.exported:TorchScriptNetwork")
        return network(path, observation_space, action_space)
    if not has_statistics:
        _check_statistics(path, environment)
    load_sb3 = load("sada_gym.agents.sb3_zip:load_sb3")
    return load_sb3(path, observation_space, action_space, allow_pickle=allow_pickle)


def _check_statistics(path: Path, environment: str) -> None:
    """Raise `UserError` if the statistics of a `VecNormalize` lie where training leaves them."""
    folders = (path.parent, path.parent / path.stem, path.parent / (environment or path.stem))
    for file in sorted(file for folder in folders for file in folder.glob("*.p*k*l*")):
        if file.suffix in (".pkl", ".pickle") and _holds_statistics(file):
            raise UserError(
                f"Expected to know whether the agent in {path} was trained under the VecNormalize "
                f"in {file}: without its statistics another agent would be attacked. Pass "
                f"vec_normalize={str(file)!r} and allow_pickle=True, for the file is a pickle, or "
                "vec_normalize=False if the agent needs none."
            )


def _holds_statistics(file: Path) -> bool:
    try:
        with file.open("rb") as opened:
            begins = opened.read(_READ_FIRST)
    except OSError:
        return False
    return "normalize" in file.name.lower() or b"VecNormalize" in begins
