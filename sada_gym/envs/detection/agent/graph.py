"""Turns a TensorFlow.js graph of convolutions into the fewer steps of a `StepNetwork`.

A trained graph is a list of small nodes whose images lie with their colours last. Here constants
are folded into the weights of convolutions, and activations belong to the convolution before them.

The steps see every image turned by half a turn, and their kernels are turned as well. TensorFlow
fills the last row and column more than the first where a stride leaves a choice; in a turned
picture that is the first row, which torch's convolutions fill too, without a copy of the image.
"""

from __future__ import annotations

import base64
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors.numpy import save

from sada_gym.errors import FileError

Array = npt.NDArray[np.float32]

_CONVOLUTIONS = {
    "Conv2D": False,
    "_FusedConv2D": False,
    "DepthwiseConv2dNative": True,
    "FusedDepthwiseConv2dNative": True,
}
"""Whether each kind of convolution is depthwise."""

_ACTIVATIONS = {"Relu": "relu", "Relu6": "relu6", "Sigmoid": "sigmoid"}


@dataclass(frozen=True)
class _Output:
    """What a node gives: `scale` times the output of a step."""

    step: int
    scale: float = 1.0


@dataclass
class _Converter:
    nodes: Mapping[str, Mapping[str, Any]]
    constants: Mapping[str, npt.NDArray[Any]]
    users: Counter[str]
    steps: list[dict[str, Any]] = field(default_factory=lambda: [{"op": "image"}])
    weights: dict[str, Array] = field(default_factory=dict)
    values: dict[str, _Output] = field(default_factory=dict)

    def value(self, name: str) -> _Output:
        """Return a node's value, and lay out the steps that it needs."""
        if name not in self.values:
            self.values[name] = self._convert(self.nodes[name], name)
        return self.values[name]

    def _convert(self, node: Mapping[str, Any], name: str) -> _Output:
        op, inputs = node["op"], node.get("input", [])
        if op == "Placeholder":
            return _Output(0)
        if op in _CONVOLUTIONS:
            return self._convolution(node, *inputs)
        if op == "Mul":
            return self._product(*inputs)
        if op == "Add":
            first, second = map(self.value, inputs)
            share = second.scale / first.scale
            return self._step("add", first.step, second.step, scale=first.scale, alpha=share)
        if op == "ConcatV2":
            parts = [self.value(part) for part in inputs[:-1]]
            if len({part.scale for part in parts}) == 1:
                return self._step("concat", *(part.step for part in parts), scale=parts[0].scale)
        if op == "Identity":
            return self.value(inputs[0])
        if op in _ACTIVATIONS:
            return self._activation(_ACTIVATIONS[op], inputs[0])
        if op == "Mean":
            averaged = self.value(inputs[0])
            return self._step("mean", averaged.step, scale=averaged.scale)
        if op == "ResizeBilinear":
            resized = self.value(inputs[0])
            return self._step("double", resized.step, scale=resized.scale)
        raise FileError(f"Expected a graph of convolutions, got {op} as its node {name}.")

    def _step(self, op: str, *inputs: int, scale: float = 1.0, **settings: Any) -> _Output:
        self.steps.append({"op": op, "inputs": list(inputs), **settings})
        return _Output(len(self.steps) - 1, scale)

    def _convolution(
        self, node: Mapping[str, Any], image: str, kernel: str, bias: str | None = None
    ) -> _Output:
        seen, weights = self.value(image), self.constants[kernel]
        height, width, channels, outputs = weights.shape
        stride = {int(n) for n in node["attr"]["strides"]["list"]["i"][1:3]}
        same = _text(node["attr"]["padding"]["s"]) == "SAME"
        if height != width or not height % 2 or not stride <= {1, 2} or len(stride) > 1:
            raise FileError(f"Expected square kernels and a stride of 1 or 2, got {node['name']}.")
        if not same and height > 1:
            raise FileError(f"Expected images filled up at their edges, got {node['name']}.")
        depthwise = _CONVOLUTIONS[node["op"]]
        if depthwise:
            weights = weights.reshape(height, width, 1, channels * outputs)
        turned = weights.transpose(3, 2, 0, 1)[:, :, ::-1, ::-1] * np.float32(seen.scale)
        number = str(len(self.steps))
        self.weights[f"{number}.weight"] = np.ascontiguousarray(turned)
        fused = [_text(each) for each in _list(node, "fused_ops")]
        if fused[:1] == ["BiasAdd"] and bias is not None:
            self.weights[f"{number}.bias"] = np.ascontiguousarray(self.constants[bias])
            fused = fused[1:]
        activation = _ACTIVATIONS[fused[0]] if fused else ""
        return self._step(
            "convolution",
            seen.step,
            stride=stride.pop(),
            groups=channels if depthwise else 1,
            activation=activation,
        )

    def _activation(self, activation: str, name: str) -> _Output:
        seen = self.value(name)
        step = self.steps[seen.step]
        if seen.scale != 1:
            raise FileError(f"Expected {name} without a factor before its {activation}.")
        if self.users[name] == 1 and step["op"] == "convolution" and not step["activation"]:
            step["activation"] = activation
            return seen
        return self._step(activation, seen.step)

    def _product(self, first: str, second: str) -> _Output:
        for factor, other in ((first, second), (second, first)):
            if factor not in self.constants:
                continue
            scale = float(self.constants[factor])
            shifted = self._shifted(other)
            if shifted is None or self.users[shifted] > 1:
                value = self.value(other)
                return _Output(value.step, value.scale * scale)
            return self._hard("hardsigmoid", shifted, scale)
        for gate, other in ((first, second), (second, first)):
            shifted = self._shifted(gate)
            scaled = self.nodes[other].get("input", [])
            if shifted is not None and self.nodes[other]["op"] == "Mul" and shifted in scaled:
                (factor,) = (each for each in scaled if each != shifted)
                if self.users[shifted] == 2:
                    return self._hard("hardswish", shifted, float(self.constants[factor]))
        a, b = self.value(first), self.value(second)
        return self._step("multiply", a.step, b.step, scale=a.scale * b.scale)

    def _shifted(self, name: str) -> str | None:
        """Return x where a node is min(max(x + 3, 0), 6)."""
        node = self.nodes[name]
        if node["op"] != "Relu6" or self.nodes[node["input"][0]]["op"] != "Add":
            return None
        x, three = self.nodes[node["input"][0]]["input"]
        return x if three in self.constants and self.constants[three] == 3 else None

    def _hard(self, activation: str, name: str, scale: float) -> _Output:
        """Return `scale` instead of 1/6 times the clipped values, as the graph has it."""
        seen = self.value(name)
        step = self.steps[seen.step]
        if seen.scale != 1 or step["op"] != "convolution" or step["activation"]:
            raise FileError(f"Expected a plain convolution before the {activation} of {name}.")
        step["activation"] = activation
        return _Output(seen.step, 6 * scale)


def convert(model: bytes, weights: bytes, outputs: Sequence[str]) -> bytes:
    """Convert a graph's JSON and its weights into the file of a `StepNetwork`.

    Args:
        model: The content of the graph's JSON file.
        weights: The content of the file of weights beside it.
        outputs: The nodes whose values the network returns.

    Raises:
        FileError: If the graph has other nodes than convolutions and what surrounds them.
    """
    described = json.loads(model)
    nodes = {node["name"]: node for node in described["modelTopology"]["node"]}
    constants = _constants(described["weightsManifest"], weights)
    users = Counter(each for node in nodes.values() for each in node.get("input", []))
    converter = _Converter(nodes, constants, users)
    values = [converter.value(name) for name in outputs]
    program = {
        "steps": converter.steps,
        "outputs": [[value.step, value.scale] for value in values],
    }
    return save(converter.weights, {"architecture": json.dumps(program, sort_keys=True)})


def _constants(
    manifest: Sequence[Mapping[str, Any]], content: bytes
) -> dict[str, npt.NDArray[Any]]:
    entries = [entry for group in manifest for entry in group["weights"]]
    kinds = [np.dtype(entry.get("quantization", entry)["dtype"]) for entry in entries]
    counts = [math.prod(entry["shape"]) for entry in entries]
    size = sum(kind.itemsize * count for kind, count in zip(kinds, counts, strict=True))
    if size != len(content):
        raise FileError(f"Expected {size:,} bytes of weights, got {len(content):,}.")
    constants: dict[str, npt.NDArray[Any]] = {}
    start = 0
    for entry, kind, count in zip(entries, kinds, counts, strict=True):
        values = np.frombuffer(content, kind, count, start)
        start += values.nbytes
        constants[entry["name"]] = values.astype(entry["dtype"]).reshape(entry["shape"])
    return constants


def _list(node: Mapping[str, Any], name: str) -> list[str]:
    found: list[str] = node["attr"].get(name, {}).get("list", {}).get("s", [])
    return found


def _text(encoded: str) -> str:
    return base64.b64decode(encoded).decode()
