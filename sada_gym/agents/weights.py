"""Agents in files: weights alone, as safetensors, so that a file can run no code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from sada_gym.errors import FileError

_ARCHITECTURE = "architecture"


@dataclass(frozen=True)
class WeightsFile:
    """A file that should hold the weights of a kind of agent, which `trained_by` trains."""

    path: Path
    content: str
    kind: str
    trained_by: str

    def error(self, got: str) -> FileError:
        """Return an error that says what was expected, what came, and how to fix it."""
        return FileError(
            f"Expected {self.content} in {self.path}{got}. Write such a file in the repository by "
            f"python -m {self.trained_by}, or, for your own {self.kind}, pass the model as "
            "agent=model."
        )


def save_weights(
    module: nn.Module, path: Path, architecture: Mapping[str, Any] | None = None
) -> None:
    """Write a module's weights, each shared one once, and how it is built as JSON in the header."""
    weights = {name: value.detach().contiguous() for name, value in _weights(module).items()}
    header = {_ARCHITECTURE: json.dumps(dict(architecture), sort_keys=True)} if architecture else {}
    save_file(weights, path, header or None)


def load_weights(
    module: nn.Module, file: WeightsFile, architecture: Mapping[str, Any] | None = None
) -> None:
    """Read a module's weights from a file whose header names this architecture, if one is given.

    It raises `FileError` if the file is no safetensors file, is of another architecture, lacks a
    weight, has one too many or one of another shape, or holds a number that is not finite.
    """
    weights, header = read_weights(file)
    if architecture is not None:
        expected = json.dumps(dict(architecture), sort_keys=True)
        if header != expected:
            built = "one that does not say how it is built" if header is None else header
            raise file.error(f", built as {expected}, got {built}")
    wanted = _weights(module)
    shapes, given = ({k: tuple(v.shape) for k, v in part.items()} for part in (wanted, weights))
    for name in {**shapes, **given}:
        if name not in shapes:
            raise file.error(f", without {name}, got one")
        if given.get(name) != shapes[name]:
            got = given.get(name, f"no {name}")
            raise file.error(f": {name} of shape {shapes[name]}, got {got}")
        if not torch.isfinite(weights[name]).all():
            raise file.error(f", all of them finite, got NaN or infinity in {name}")
    with torch.no_grad():
        for name, value in wanted.items():
            value.copy_(weights[name])


def read_weights(file: WeightsFile) -> tuple[dict[str, Tensor], str | None]:
    """Read a file's tensors by name, and the architecture that its header names, if any."""
    try:
        with safe_open(file.path, "pt") as tensors:
            header = (tensors.metadata() or {}).get(_ARCHITECTURE)
            names = tensors.keys()
            return {name: tensors.get_tensor(name) for name in names}, header
    except (SafetensorError, OSError) as error:
        raise file.error(f", got no safetensors file ({error})") from error


def _weights(module: nn.Module) -> dict[str, Tensor]:
    """Return a module's parameters and buffers, each shared one under one name."""
    return {**dict(module.named_parameters()), **dict(module.named_buffers())}
