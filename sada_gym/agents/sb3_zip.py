"""SB3's zip files, loaded without unpickling, so that a file can run no code.

The JSON `data` of such a file shows most objects twice: pickled, and in words for readers. Only the
words are read here. Weights are read by torch, which builds nothing but tensors.
"""

from __future__ import annotations

import base64
import inspect
import io
import json
import pickletools
import re
import zipfile
from collections.abc import Mapping
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import stable_baselines3
import torch
from stable_baselines3.common import torch_layers
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch.nn.modules import activation

from sada_gym.agents.exported import MAX_MODEL_BYTES
from sada_gym.agents.sb3_spaces import network_space, validate_action_space
from sada_gym.errors import FileError, MissingExtra, UserError, explained, install_line
from sada_gym.foundations.determinism import generators_kept
from sada_gym.foundations.files import as_path, read_file

_ALGORITHMS = {
    "clip_range": "PPO",
    "exploration_fraction": "DQN",
    "target_entropy": "SAC",
    "policy_delay": "TD3",  # DDPG's too: it is TD3 with other settings
    "gae_lambda": "A2C",
}
"""The algorithm whose files have this key and none of those above."""

_CONTRIB = {
    "sb3_contrib.tqc.": "TQC",
    "sb3_contrib.qrdqn.": "QRDQN",
    "sb3_contrib.ars.": "ARS",
    "sb3_contrib.crossq.": "CrossQ",
    "sb3_contrib.common.maskable.": "MaskablePPO",
    "sb3_contrib.common.recurrent.": "RecurrentPPO",
}
"""The algorithm of sb3-contrib whose policy class begins so; TRPO has SB3's own."""

_CLASSES = {
    str(kind): kind
    for kind in (
        *(getattr(activation, name) for name in activation.__all__),
        torch_layers.FlattenExtractor,
        torch_layers.NatureCNN,
        torch_layers.CombinedExtractor,
    )
}
"""The classes in a policy's arguments that are known by the words that a file has for them."""

_TRAINING_ONLY = {"optimizer_class", "optimizer_kwargs", "device"}
_PICKLE_HINT = (
    "Load it yourself and pass the model, such as agent=PPO.load(file), or let "
    "allow_pickle=True unpickle your own file."
)
_BAD_ARGUMENTS = (TypeError, ValueError, RuntimeError, AssertionError, LookupError, AttributeError)
_FIX = "Name a file that model.save(file) wrote."


def load_sb3(
    path: str | Path,
    observation_space: gym.Space[Any],
    action_space: gym.Space[Any],
    *,
    allow_pickle: bool = False,
) -> Any:
    """Load a model of PPO, A2C, DQN, SAC, TD3, DDPG or sb3-contrib, on the CPU, for acting.

    Its `predict` returns the same actions, bit for bit, as a model that SB3 itself loads. It has no
    buffers and no optimiser. DDPG is loaded as TD3, which has the same policy. The spaces are those
    of the environment, after a check against the file; stacked frames and transposed pictures are
    recognised by that.

    Args:
        path: The zip file.
        observation_space: The environment's observations.
        action_space: The environment's actions.
        allow_pickle: Whether to unpickle the file as SB3 does, which can run any code in it.

    Raises:
        FileError: If the file is missing, damaged, too large, or not written by SB3.
        UserError: If it can be read only by unpickling it, or it is for other spaces.
    """
    path = as_path(path, "an SB3 model")
    content = read_file(path, MAX_MODEL_BYTES)
    data = _read_data(path, content)
    policy_class = _referenced_class(data.get("policy_class"))
    algorithm = _algorithm(path, data, policy_class)
    with generators_kept():
        if allow_pickle:
            expected = f"Expected a {algorithm.__name__} model that can be unpickled in {path}"
            fix = "Load it where it was saved, and pass the model."
            with explained(expected, fix, FileError):
                return algorithm.load(io.BytesIO(content), device="cpu")
        policies = algorithm.policy_aliases.values()
        known = {f"{kind.__module__}.{kind.__name__}": kind for kind in policies}
        if policy_class not in known:
            raise _needs_pickle(path, "a policy of SB3's", policy_class or "a class of its own")
        weights = _read_weights(path, content)
        return _rebuilt(
            path,
            data,
            weights,
            algorithm,
            known[policy_class],
            network_space(path, data.get("observation_space"), observation_space),
            validate_action_space(path, data.get("action_space"), action_space),
        )


def _rebuilt(
    path: Path,
    data: Mapping[str, Any],
    weights: dict[str, torch.Tensor],
    algorithm: type[Any],
    policy_class: type[Any],
    observation_space: gym.Space[Any],
    action_space: gym.Space[Any],
) -> Any:
    arguments = _policy_arguments(path, data)
    taken = inspect.signature(policy_class).parameters
    if issubclass(algorithm, OnPolicyAlgorithm) and "use_sde" in taken:
        arguments["use_sde"] = data.get("use_sde") is True
    schedule = {"lr_schedule": lambda _: 0.0} if "lr_schedule" in taken else {}
    stored = sum(part.numel() for part in weights.values())
    try:
        if not _can_hold(arguments, stored):
            raise ValueError(f"its {stored:,} weights cannot fill such layers")
        policy = policy_class(observation_space, action_space, **schedule, **arguments)
    except _BAD_ARGUMENTS as error:
        raise UserError(
            f"Expected policy_kwargs in {path} that {policy_class.__name__} takes with "
            f"observations {observation_space} and actions {action_space}, got {arguments} "
            f"({error}). Name an agent that was trained on this environment. {_PICKLE_HINT}"
        ) from error
    shapes = {name: tuple(part.shape) for name, part in policy.state_dict().items()}
    for name in shapes.keys() - weights.keys():  # files of SB3 before 1.7 name a shared part once
        shared = re.sub(r"^(pi|vf)_features_extractor\.", "features_extractor.", name)
        if shared in weights:
            weights[name] = weights[shared]
    stored_shapes = {name: tuple(part.shape) for name, part in weights.items()}
    for name in sorted({*shapes, *weights}):
        if stored_shapes.get(name) != shapes.get(name):
            raise UserError(
                f"Expected an agent for observations {observation_space} and actions "
                f"{action_space} in {path}, whose {name} has the shape "
                f"{shapes.get(name, 'none')}, got {stored_shapes.get(name, 'none')}. Name an agent "
                "that was trained on this environment."
            )
    policy.load_state_dict(weights)
    policy.set_training_mode(False)
    model = algorithm(policy=policy_class, env=None, device="cpu", _init_setup_model=False)
    model.observation_space, model.action_space = observation_space, action_space
    model.policy, model.policy_kwargs = policy, arguments
    model.use_sde = data.get("use_sde") is True
    return model


def _read_data(path: Path, content: bytes) -> dict[str, Any]:
    """Read the JSON of an SB3 file, in which pickles are strings that stay strings."""
    text = _member(path, content, "data")
    expected = f"Expected a JSON object with a policy_class as data in {path}"
    with explained(expected, _FIX, FileError):
        data: dict[str, Any] = json.loads(text)
        if not isinstance(data, dict) or "policy_class" not in data:
            raise ValueError("something else")
        return data


def _read_weights(path: Path, content: bytes) -> dict[str, torch.Tensor]:
    pth = _member(path, content, "policy.pth")
    most = f"at most {MAX_MODEL_BYTES >> 20} MiB"
    expected = f"Expected tensors alone as policy.pth in {path}, {most}"
    with explained(expected, "Save the model again.", FileError):
        with zipfile.ZipFile(io.BytesIO(pth)) as archive:
            if sum(part.file_size for part in archive.infolist()) > MAX_MODEL_BYTES:
                raise ValueError("more")
        weights = torch.load(io.BytesIO(pth), "cpu", weights_only=True)
        for name, value in weights.items():
            if not isinstance(name, str) or not isinstance(value, torch.Tensor):
                raise TypeError(f"{name!r} of {type(value).__name__}")
        return dict(weights)


def _member(path: Path, content: bytes, name: str) -> bytes:
    """Read one part of a zip file, unless it claims to be too large."""
    expected = f"Expected a zip file that SB3 wrote in {path}"
    with (
        explained(f"{expected}, not damaged", _FIX, FileError),
        zipfile.ZipFile(io.BytesIO(content)) as archive,
    ):
        parts = {part.filename: part.file_size for part in archive.infolist()}
        for wanted in ("data", name):
            if wanted not in parts:
                listed = ", ".join([*parts][:5]) or "an empty one"
                raise FileError(f"{expected}, with {wanted} in it, got {listed}. {_FIX}")
        if parts[name] > MAX_MODEL_BYTES:
            raise FileError(
                f"Expected {name} in {path} to be at most {MAX_MODEL_BYTES >> 20} MiB, got "
                f"{parts[name] >> 20:,} MiB. Save the model without what only training needs."
            )
        return archive.read(name)


def _referenced_class(entry: Any) -> str | None:
    """Return the class that a pickle refers to by name; None where it holds anything else.

    The pickle is taken apart, never run.
    """
    try:
        pickled = base64.b64decode(entry[":serialized:"])
        steps = [(step.name, given) for step, given, _ in pickletools.genops(pickled)]
    except (TypeError, LookupError, ValueError):
        return None
    used = [step for step in steps if step[0] not in ("PROTO", "FRAME", "MEMOIZE", "STOP")]
    if [name for name, _ in used] == ["SHORT_BINUNICODE", "SHORT_BINUNICODE", "STACK_GLOBAL"]:
        return f"{used[0][1]}.{used[1][1]}"
    return None


def _algorithm(path: Path, data: Mapping[str, Any], policy_class: str | None) -> type[Any]:
    known_by = _CONTRIB.items()
    names = [name for start, name in known_by if (policy_class or "").startswith(start)]
    names = ["TRPO"] if "cg_max_steps" in data else names
    library: Any = stable_baselines3
    if names:
        try:
            library = import_module("sb3_contrib")
        except ImportError as error:
            raise MissingExtra(
                f"Expected sb3-contrib to be installed, for {path} holds a model of its "
                f"{names[0]}. {install_line('contrib')}"
            ) from error
    names += [name for key, name in _ALGORITHMS.items() if key in data]
    if not names:
        raise UserError(
            f"Expected a model of PPO, A2C, DQN, SAC, TD3, DDPG or one of sb3-contrib's in {path}, "
            "got one of another algorithm. Load it yourself and pass the model, such as "
            "agent=Mine.load(file)."
        )
    algorithm: type[Any] = getattr(library, names[0])
    return algorithm


def _policy_arguments(path: Path, data: Mapping[str, Any]) -> dict[str, Any]:
    """Read a policy's arguments: plain data, and classes that are known by their words."""
    entry = data.get("policy_kwargs")
    if not isinstance(entry, dict) or entry.get(":type:", "<class 'dict'>") != "<class 'dict'>":
        raise _needs_pickle(path, "policy_kwargs that are a dictionary", "others")
    arguments = {}
    for key, value in entry.items():
        if key.startswith(":") or key in _TRAINING_ONLY:
            continue
        if isinstance(value, str) and value not in _CLASSES:
            raise _needs_pickle(
                path, "policy_kwargs of plain data and known classes", f"{key}={value}"
            )
        arguments[key] = _CLASSES[value] if isinstance(value, str) else value
    layers = arguments.get("net_arch")
    if isinstance(layers, list) and layers and isinstance(layers[0], dict):
        arguments["net_arch"] = layers[0]  # as SB3 1.x wrote them
    return arguments


def _can_hold(argument: Any, stored: int) -> bool:
    """Whether so many weights can fill the layers that an argument asks for.

    A layer between neighbours in a list has as many weights as their product.
    """
    if isinstance(argument, Mapping):
        return all(_can_hold(part, stored) for part in argument.values())
    if isinstance(argument, list):
        widths = [width for width in argument if isinstance(width, int)]
        return all(_can_hold(part, stored) for part in argument) and all(
            width * following <= stored for width, following in pairwise(widths)
        )
    return not isinstance(argument, int) or argument <= stored


def _needs_pickle(path: Path, expected: str, got: str) -> UserError:
    return UserError(
        f"Expected {expected} in {path}, got {got}, which cannot be known without unpickling. "
        f"{_PICKLE_HINT}"
    )
