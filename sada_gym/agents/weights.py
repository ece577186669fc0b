"""Agents in files: weights alone, as safetensors, so that a file can run no code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from sada_gym.errors import UserError

_ARCHITECTURE = "architecture"


def save_weights(module: nn.Module, path: Path, architecture: Mapping[str, Any]) -> None:
    """Write a module's weights, each shared one once, and beside them what it is built like.

    Args:
        module: Its parameters and buffers are written.
        path: The safetensors file.
        architecture: JSON-compatible; stands as JSON in the file's header.
    """
    weights = {name: value.contiguous() for name, value in _weights(module).items()}
    save_file(weights, path, {_ARCHITECTURE: json.dumps(dict(architecture), sort_keys=True)})


def load_weights(
    module: nn.Module, path: Path, what: str, architecture: Mapping[str, Any] | None = None
) -> None:
    """Read a module's weights from a file.

    Args:
        module: Receives them.
        path: The safetensors file.
        what: What the file should hold, for messages: `the weights of a driver`.
        architecture: What the file's header must say; None where it says nothing.

    Raises:
        UserError: If the file is no safetensors file, is of another architecture, lacks a weight,
            has one too many or one of another shape, or holds a number that is not finite.
    """
    weights, header = read_weights(path, what)
    if architecture is not None:
        expected = json.dumps(dict(architecture), sort_keys=True)
        if header != expected:
            raise UserError(
                f"Expected {what} in {path}, built as {expected}, got one built as {header}."
            )
    wanted = _weights(module)
    for name, value in wanted.items():
        shape = tuple(value.shape)
        if name not in weights:
            raise UserError(
                f"Expected {what} in {path}, with {name} of shape {shape}, got no {name}."
            )
        if weights[name].shape != value.shape:
            found = tuple(weights[name].shape)
            raise UserError(
                f"Expected {what} in {path}, with {name} of shape {shape}, got shape {found}."
            )
        if not torch.isfinite(weights[name]).all():
            raise UserError(
                f"Expected {what} in {path}, all of them finite, got NaN or infinity in {name}. "
                "Train the agent again, or restore the file."
            )
    extra = sorted(weights.keys() - wanted.keys())
    if extra:
        raise UserError(f"Expected {what} in {path}, without {extra[0]}, got one with it.")
    with torch.no_grad():
        for name, value in wanted.items():
            value.copy_(weights[name])


def read_weights(path: Path, what: str) -> tuple[dict[str, Tensor], str | None]:
    """Read a file's tensors by name, and the architecture that its header tells, if any.

    Raises:
        UserError: If it is no safetensors file.
    """
    try:
        with safe_open(path, "pt") as file:
            header = (file.metadata() or {}).get(_ARCHITECTURE)
            return {name: file.get_tensor(name) for name in file.keys()}, header  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise UserError(f"Expected {what} in {path}, got no safetensors file ({error}).") from error


def _weights(module: nn.Module) -> dict[str, Tensor]:
    """A module's parameters and buffers, without the second names of shared ones."""
    return {**dict(module.named_parameters()), **dict(module.named_buffers())}
