"""ONNX files as agents, by onnxruntime, on the CPU in one thread."""

from __future__ import annotations

import numpy as np

from sada_gym.agents.exported import Array, ExportedNetwork, input_names, takes_channels_first
from sada_gym.agents.tile import Batch, keyed
from sada_gym.errors import FileError, MissingExtra, explained, install_line

_TYPES = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(float16)": np.float16,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
    "tensor(uint8)": np.uint8,
    "tensor(bool)": np.bool_,
}


class OnnxNetwork(ExportedNetwork):
    """A network of an ONNX file; `torch.onnx` may have laid weights beside it, as FILE.data."""

    packages = ("onnxruntime",)
    beside = ".data"

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
        mend = "Name a file that torch.onnx.export or the like wrote, and what lay beside it."
        model, *weights = self._contents
        with explained(f"Expected an ONNX model in {self.path}", mend, FileError):
            if weights:
                names, sizes = [f"{self.path.name}.data"], [len(weights[0])]
                options.add_external_initializers_from_files_in_memory(names, weights, sizes)
            self._session = onnxruntime.InferenceSession(
                model, options, providers=["CPUExecutionProvider"]
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
