"""The table of the sets of shapes, and how one is found by its name or a folder's path."""

from __future__ import annotations

import difflib
import re
from pathlib import Path

from sada_gym.envs.detection.shapes.cad import load_class
from sada_gym.envs.detection.shapes.model import Shape
from sada_gym.errors import UserError, UserTypeError
from sada_gym.foundations.files import file_errors
from sada_gym.foundations.parts import find_part

SHAPES: dict[str, str] = {
    "benchmark": "sada_gym.envs.detection.shapes.catalogue:benchmark_shapes",
    "sweethome3d": "sada_gym.envs.detection.shapes.textured:sweethome3d",
    "flightgear": "sada_gym.envs.detection.shapes.textured:flightgear",
    "textured": "sada_gym.envs.detection.shapes.textured:textured",
}
"""The `module:function` of each set of shapes; it turns a class's name into a tuple of `Shape`."""

DEFAULT_SHAPES = "benchmark"


def is_named(shapes: str | Path) -> bool:
    """Say whether shapes are given by a name of `SHAPES` or a `module:function`, not by a path."""
    return isinstance(shapes, str) and (
        shapes in SHAPES or re.fullmatch(r"[\w.]+:\w+", shapes) is not None
    )


def find_shapes(
    shapes: str | Path, object_class: str, *, skip_unreadable: bool = False
) -> tuple[Shape, ...]:
    """Find the shapes of a class by a key of `SHAPES`, a `module:function`, or a folder's path.

    `load_folder` says what a folder holds, and what `skip_unreadable` does.

    Raises:
        UserError: If there is no such set, folder or class, or a file cannot be read.
    """
    if not isinstance(shapes, str | Path):
        raise UserTypeError(
            f"Expected shapes to be a name among {', '.join(SHAPES)} or the path of a folder, got "
            f"{shapes!r}."
        )
    if not isinstance(object_class, str):
        raise UserTypeError(f"Expected object_class to be a class's name, got {object_class!r}.")
    path = Path(shapes)
    if isinstance(shapes, str) and is_named(shapes):
        chosen = find_part("shape set", shapes, SHAPES)(object_class)
        if not isinstance(chosen, tuple) or not chosen or not isinstance(chosen[0], Shape):
            raise UserError(f"Expected a tuple of Shape objects from {shapes!r}, got {chosen!r}.")
        return chosen
    with file_errors("find the folder of shapes", path):
        is_folder = path.is_dir()
    if not is_folder and len(path.parts) == 1:
        close = difflib.get_close_matches(str(path), SHAPES, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        raise UserError(
            f"Expected shapes to be a name among {', '.join(SHAPES)} or a folder of CAD files, "
            f"got {str(shapes)!r}.{hint}"
        )
    return load_class(path, object_class, skip_unreadable=skip_unreadable)
