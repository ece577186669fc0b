"""TorchScript files as agents, on the CPU."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import torch

from sada_gym.agents.exported import Array, ExportedNetwork, input_names
from sada_gym.agents.tile import Batch
from sada_gym.errors import FileError, explained


class TorchScriptNetwork(ExportedNetwork):
    """A network of a file that `torch.jit.script(module).save(path)` or `torch.jit.trace` wrote.

    It is a program in torch's own language, so trust it. A dictionary is given as keywords.
    """

    def _open(self) -> None:
        mend = "Write it by torch.jit.script(module).save(file); torch.save writes other files."
        with explained(f"Expected a TorchScript module in {self.path}", mend, FileError):
            load: Any = torch.jit.load
            self._module = load(io.BytesIO(self._contents[0]), map_location="cpu")
        self._module.eval()
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
