"""ONNX files as agents, by onnxruntime, on the CPU in one thread."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from sada_gym.agents.exported import Array, ExportedNetwork, input_names, takes_channels_first
from sada_gym.agents.sb3_zip import MAX_MODEL_BYTES
from sada_gym.agents.tile import Batch, keyed
from sada_gym.errors import FileError, MissingExtra, explained, install_line
from sada_gym.files import read_file

_TYPES = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(float16)": np.float16,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
    "tensor(uint8)": np.uint8,
    "tensor(bool)": np.bool_,
}


def load_onnx(
    path: Path, observation_space: spaces.Space[Any], action_space: spaces.Space[Any]
) -> OnnxNetwork:
    """Load an ONNX file as an agent.

    Args:
        path: The file; weights that `torch.onnx` laid beside it, as FILE.data, are read, too.
        observation_space: The environment's observations.
        action_space: The environment's actions.

    Raises:
        FileError: If it is no such file.
        UserError: If onnxruntime is missing, or the network is not for these spaces.
    """
    beside = path.with_name(f"{path.name}.data")
    data = read_file(beside, MAX_MODEL_BYTES) if beside.is_file() else b""
    content = read_file(path, MAX_MODEL_BYTES)
    return OnnxNetwork(path, content, observation_space, action_space, data)


class OnnxNetwork(ExportedNetwork):
    """A network of an ONNX file; `data` holds weights that lay beside it."""

    packages = ("onnxruntime",)

    def __init__(
        self,
        path: Path,
        content: bytes,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        data: bytes = b"",
    ) -> None:
        self._data = data
        super().__init__(path, content, observation_space, action_space)

    @property
    def weights_hash(self) -> str:
        """SHA-256 over the file and the weights beside it."""
        return hashlib.sha256(self._content + self._data).hexdigest()

    def __getstate__(self) -> dict[str, Any]:
        """Keep the weights beside the file, too."""
        return {**super().__getstate__(), "_data": self._data}

    def _open(self) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise MissingExtra(
                f"Expected onnxruntime to be installed for the agent in {self.path}. "
                f"{install_line('onnx')}"
            ) from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        if self._data:
            name = f"{self.path.name}.data"
            options.add_external_initializers_from_files_in_memory(
                [name], [self._data], [len(self._data)]
            )
        mend = "Name a file that torch.onnx.export or the like wrote, and what lay beside it."
        with explained(f"Expected an ONNX model in {self.path}", mend, FileError):
            self._session = onnxruntime.InferenceSession(
                self._content, options, providers=["CPUExecutionProvider"]
            )
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
            given[name] = value.astype(_TYPES.get(wanted.type, np.float32))
        first: Array = self._session.run(None, given)[0]
        return first
