"""Networks that another framework exported as ONNX or TorchScript, as agents."""

from __future__ import annotations

import hashlib
import io
import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces

from sada_gym.agents.tile import ALONE, Batch, keyed, tiled
from sada_gym.errors import FileError, MissingExtra, Notice, UserError, explained, install_line
from sada_gym.foundations.files import read_file

Array = npt.NDArray[Any]
MAX_MODEL_BYTES = 500 * 2**20
"""Larger files, and zips with larger parts, are refused unread."""

_CHANNELS = (1, 3, 4)
"""How many numbers a pixel of a picture has."""

_ONNX_TYPES = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(float16)": np.float16,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
    "tensor(uint8)": np.uint8,
    "tensor(bool)": np.bool_,
}


class ExportedFile(ABC):
    """A network's file, which is held in memory: the network is sent to workers as its content."""

    beside: str | None = None
    """The ending of the name of a file that may lie beside it, and belongs to it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._contents = [read_file(path, MAX_MODEL_BYTES)]
        if self.beside and (other := path.with_name(path.name + self.beside)).is_file():
            self._contents.append(read_file(other, MAX_MODEL_BYTES))
        self._sent = (*self.__dict__,)
        self._open()

    @abstractmethod
    def _open(self) -> None:
        """Read the network from `_contents`: its file, and what lay beside it, if anything."""

    @property
    def weights_hash(self) -> str:
        """SHA-256 over the files, which say all that the network does."""
        return hashlib.sha256(b"".join(self._contents)).hexdigest()

    def __getstate__(self) -> dict[str, Any]:
        """Keep the files' contents instead of the network."""
        return {key: self.__dict__[key] for key in (*self._sent, "_sent")}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Read the network again."""
        self.__dict__.update(state)
        self._open()


class ExportedNetwork(ExportedFile):
    """An agent whose `predict` asks an exported network for batches.

    Its first output holds the actions; of choices it may hold a number for each (logits or Q
    values), of which the highest counts.

    Args:
        path: The network's file.
        observation_space: The environment's observations.
        action_space: The environment's actions.

    Attributes:
        fixed: The rows that the network always takes; None if it takes any number.

    Raises:
        FileError: If it is no such file.
        UserError: If the network is not for these spaces.
    """

    fixed: int | None = None

    def __init__(
        self,
        path: Path,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
    ) -> None:
        self.observation_space, self.action_space = observation_space, action_space
        super().__init__(path)

    @abstractmethod
    def _outputs(self, inputs: Batch) -> Array:
        """Return the first output for a batch, (n, ...)."""

    def predict(self, observation: Any, *, deterministic: bool) -> tuple[Array, None]:
        """Return the actions for a batch of observations, (n, ...)."""
        if not deterministic:
            raise UserError(
                f"Expected deterministic=True with {self.path.name}: an exported network draws no "
                "actions."
            )
        plain = not isinstance(self.observation_space, spaces.Dict)
        batch: Mapping[str, Array] = {ALONE: observation} if plain else observation
        with explained(
            f"Expected actions for observations {self.observation_space} from {self.path}",
            "Export the network so that it takes these observations, a batch at a time.",
        ):
            if self.fixed is None:
                outputs = self._outputs(dict(batch))
            else:
                outputs = np.concatenate(tiled(self._outputs, batch, self.fixed))
        count = len(next(iter(batch.values())))
        return self._actions(np.asarray(outputs), count), None

    def _actions(self, outputs: Array, count: int) -> Array:
        space, shape = self.action_space, self.action_space.shape or ()
        flat = outputs.reshape(count, -1) if outputs.size and outputs.ndim else outputs
        width = flat.shape[1] if flat.ndim == 2 else 0
        size = int(np.prod(shape))
        if isinstance(space, spaces.Box) and width == size:
            return flat.reshape(count, *shape)
        if isinstance(space, spaces.Discrete):
            if width == 1 and (space.n > 1 or flat.dtype.kind in "iu"):
                return np.asarray(flat[:, 0])
            if width == space.n:
                return np.asarray(space.start + flat.argmax(axis=1))
        if isinstance(space, spaces.MultiDiscrete):
            whole = flat.dtype.kind in "iu" or (flat == np.floor(flat)).all()
            if width == size and (whole or width != np.sum(space.nvec)):
                return flat.reshape(count, *shape)
            if width == np.sum(space.nvec):
                parts = np.split(flat, np.cumsum(space.nvec.ravel())[:-1], axis=1)
                best = np.stack([part.argmax(axis=1) for part in parts], axis=1)
                return best.reshape(count, *shape) + space.start
        if isinstance(space, spaces.MultiBinary) and width == size:
            return flat.reshape(count, *shape)
        raise UserError(
            f"Expected actions {space} as the first output of {self.path}, {size} for each of "
            f"{count} observations, or a number for each choice, got shape {outputs.shape}. "
            "Export the network with its actions as the first output."
        )


class OnnxNetwork(ExportedNetwork):
    """A network of an ONNX file, run by onnxruntime on the CPU in one thread.

    `torch.onnx` may have laid weights beside it, as FILE.data.
    """

    packages = ("onnxruntime",)
    beside = ".data"

    def _open(self) -> None:
        model, *weights = self._contents
        self._session = onnx_session(model, self.path, weights)
        self._inputs = {entry.name: entry for entry in self._session.get_inputs()}
        self._keys = input_names(self.observation_space, [*self._inputs], self.path)
        parts = keyed(self.observation_space)
        self._moved = {
            name
            for name, key in self._keys.items()
            if takes_channels_first(parts[key], tuple(self._inputs[name].shape), name, self.path)
        }
        rows = {(entry.shape or [None])[0] for entry in self._inputs.values()}
        self.fixed = next((size for size in rows if isinstance(size, int)), None)

    def _outputs(self, inputs: Batch) -> Array:
        given: dict[str, Array] = {}
        for name, key in self._keys.items():
            wanted = self._inputs[name]
            value = inputs[key]
            if name in self._moved:
                value = np.ascontiguousarray(np.moveaxis(value, 3, 1))
            if len(wanted.shape) == 2 and value.ndim == 1:
                value = value[:, None]
            given[name] = value.astype(_ONNX_TYPES.get(wanted.type, np.float32))
        first: Array = self._session.run(None, given)[0]
        return first


class TorchScriptNetwork(ExportedNetwork):
    """A network of a file that `torch.jit.script(module).save(path)` or `torch.jit.trace` wrote.

    It is a program in torch's own language, so trust it. A dictionary is given as keywords.
    """

    def _open(self) -> None:
        self._module = torchscript_module(self._contents[0], self.path)
        names = [argument.name for argument in self._module.forward.schema.arguments][1:]
        self._keys = input_names(self.observation_space, names, self.path)
        weights = [*self._module.parameters()]
        self._dtype = weights[0].dtype if weights else torch.float32

    def _outputs(self, inputs: Batch) -> Array:
        with torch.no_grad():
            given = {name: self._tensor(inputs[key]) for name, key in self._keys.items()}
            outputs = self._module(**given)
        first = outputs[0] if isinstance(outputs, tuple | list) else outputs
        array: Array = first.numpy()
        return array

    def _tensor(self, value: Array) -> torch.Tensor:
        """Return floats of the weights' precision, and whole numbers as they are."""
        tensor = torch.from_numpy(np.ascontiguousarray(value))
        return tensor.to(self._dtype) if tensor.is_floating_point() else tensor


def onnx_session(model: bytes, path: Path, weights: Sequence[bytes] = ()) -> Any:
    """Open an ONNX file's content with onnxruntime, on the CPU and in one thread.

    `weights` may hold the content of the file FILE.data beside it.

    Raises:
        MissingExtra: If onnxruntime is not installed.
        FileError: If it is no ONNX model.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise MissingExtra(
            f"Expected onnxruntime to be installed for the agent in {path}. {install_line('onnx')}"
        ) from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    fix = "Name a file that torch.onnx.export or the like wrote, and what lay beside it."
    with explained(f"Expected an ONNX model in {path}", fix, FileError):
        if weights:
            names, sizes = [f"{path.name}.data"], [len(weights[0])]
            options.add_external_initializers_from_files_in_memory(names, [*weights], sizes)
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def torchscript_module(content: bytes, path: Path) -> Any:
    """Open a TorchScript file's content; raise `FileError` if it is none."""
    fix = "Write it by torch.jit.script(module).save(file); torch.save writes other files."
    with explained(f"Expected a TorchScript module in {path}", fix, FileError):
        load: Any = torch.jit.load
        return load(io.BytesIO(content), map_location="cpu").eval()


def takes_channels_first(
    space: spaces.Space[Any], shape: tuple[Any, ...], name: str, path: Path
) -> bool:
    """Say whether a network's input (n, ...) asks for the pictures of a space, channels in front.

    A size that is no number is free. Where both orders fit a picture, this warns, and says no.
    """
    own, last = shape[1:], space.shape or ()
    if len(own) != 3 or len(last) != 3:
        return False
    as_is, moved = (
        all(
            not isinstance(wanted, int) or wanted == size
            for wanted, size in zip(own, sizes, strict=True)
        )
        for sizes in (last, (last[2], *last[:2]))
    )
    if as_is and moved and last[2] in _CHANNELS:
        warnings.warn(
            f"The input {name!r} of {path.name}, {list(own)} each, fits the pictures {last} of "
            "the environment as they are and with their channels in front; they are given as they "
            "are. To be sure, export it with a fixed number of channels and of rows, or let a "
            "wrapper of the environment move the channels.",
            Notice,
            stacklevel=3,
        )
    return moved and not as_is


def input_names(space: spaces.Space[Any], names: list[str], path: Path) -> dict[str, str]:
    """Return which part of the observations each input takes; raise `UserError` if one is left."""
    parts = [*keyed(space)]
    if len(names) == len(parts) == 1:
        return {names[0]: parts[0]}
    if set(names) == set(parts):
        return {name: name for name in names}
    raise UserError(
        f"Expected the inputs {', '.join(parts).replace(ALONE, 'one input')} in {path}, got "
        f"{', '.join(names) or 'none'}. Export the network with an input for each part of the "
        "observations."
    )
