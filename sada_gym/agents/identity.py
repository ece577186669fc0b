"""Hashes what a score depends on in an agent, and checks that weights are finite."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from inspect import ismethod
from typing import TYPE_CHECKING, Any

from sada_gym.errors import UserError, check_plain

if TYPE_CHECKING:
    from torch import Tensor, nn


def identity(
    fingerprint: str | None,
    agent: Any,
    agent_id: str | None,
    settings: Mapping[str, Any] | None = None,
) -> str | None:
    """Return the name by which evaluation stores know an agent.

    Args:
        fingerprint: The hash of its weights, or None if they are unknown.
        agent: The agent.
        agent_id: The name that its owner gave it, if any.
        settings: What else a score depends on: how the agent is used. JSON-compatible.

    Returns:
        The fingerprint, where the agent has no name. Otherwise a SHA-256 over the name, the kind of
        agent, its fingerprint and its settings: a name alone would let another agent's scores pass
        for this one's.
    """
    if not agent_id:
        return fingerprint
    kind = agent if hasattr(agent, "__qualname__") else type(agent)
    parts = {
        "agent_id": agent_id,
        "kind": kind.__qualname__,
        "fingerprint": fingerprint,
        "settings": dict(settings or {}),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def fingerprint(agent: Any) -> str | None:
    """Return a SHA-256 over a torch module's class, architecture and weights, or None.

    A class whose weights say the rest names its `architecture`, which outlives a move of the class.
    Its subclasses are hashed like any other class.
    """
    import torch

    if not isinstance(agent, torch.nn.Module):
        return None
    kind = type(agent)
    if "architecture" in vars(kind):
        digest = hashlib.sha256(str(agent.architecture).encode())
    else:
        digest = hashlib.sha256(f"{kind.__module__}.{kind.__qualname__}".encode())
        digest.update(_architecture(agent).encode())
    for name, value in sorted(agent.state_dict().items()):
        digest.update(f"{name}{tuple(value.shape)}{value.dtype}".encode())
        digest.update(value.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def check_finite_weights(agent: Any) -> None:
    """Check that all weights of an agent are finite numbers.

    Args:
        agent: A torch module, an SB3 model, or an object that holds one of these as an attribute.

    Raises:
        UserError: If a parameter is NaN or infinite, or a buffer NaN. (Infinity is a legal buffer:
            attention masks hold it.)
    """
    for name, values, infinity_too in _tensors(agent):
        if not values.is_floating_point():
            continue
        if values.element_size() == 1:
            values = values.float()  # torch does not test numbers of 8 bits
        wrong = ~values.isfinite() if infinity_too else values.isnan()
        if wrong.any():
            raise UserError(
                f"Expected an agent whose weights are finite numbers, got {type(agent).__name__} "
                f"with NaN or infinity in {name}. Train it again, with a lower learning rate if "
                "its training diverged, or load the weights from before that."
            )


def check_agent_id(agent_id: Any) -> None:
    """Check that an `agent_id` is a name or None; raise `UserError` if it is neither."""
    check_plain("agent_id", "" if agent_id is None else agent_id)


def _tensors(agent: Any) -> Iterator[tuple[str, Tensor, bool]]:
    """Iterate over an agent's parameters and buffers: name, values, whether it is a parameter."""
    import torch

    agent = agent.__self__ if ismethod(agent) else agent
    modules = {"": agent}
    if not isinstance(agent, torch.nn.Module):
        modules = {name: _module(part) for name, part in getattr(agent, "__dict__", {}).items()}
    for prefix, module in modules.items():
        if isinstance(module, torch.nn.Module):
            for name, parameter in module.named_parameters(prefix):
                if not torch.nn.parameter.is_lazy(parameter):
                    yield name, parameter.detach(), True
            for name, buffer in module.named_buffers(prefix):
                yield name, buffer, False


def _module(part: Any) -> Any:
    """Return the policy of an SB3 model, and anything else as it is."""
    return getattr(part, "__dict__", {}).get("policy", part)


def _architecture(module: nn.Module) -> str:
    """Describe a module: its layers as torch prints them, and their plain settings."""
    layers = re.sub(r" at 0x[0-9a-f]+", "", repr(module))
    settings = [
        f"{name}.{key}={value!r}"
        for name, layer in module.named_modules()
        for key, value in sorted(vars(layer).items())
        if key != "training" and _is_plain(value)
    ]
    return "\n".join([layers, *settings])


def _is_plain(value: Any) -> bool:
    if isinstance(value, tuple | list):
        return all(map(_is_plain, value))
    return isinstance(value, bool | int | float | str)
