"""A TensorFlow.js graph computed node by node, as slowly and plainly as its nodes are defined."""

from __future__ import annotations

import base64
import json
import math
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional

ACTIVATIONS = {"Relu": functional.relu, "Relu6": functional.relu6}
SIMPLE = {
    "Add": torch.add,
    "Mul": torch.mul,
    "Sigmoid": torch.sigmoid,
    "Identity": lambda x: x,
    **ACTIVATIONS,
}


class PlainGraph:
    """The nodes and constants of `STEM.json` and `STEM.bin`; images are (1, h, w, channels)."""

    def __init__(self, folder: Path, stem: str) -> None:
        model = json.loads((folder / f"{stem}.json").read_bytes())
        self.nodes = {node["name"]: node for node in model["modelTopology"]["node"]}
        self.constants = {}
        content, start = (folder / f"{stem}.bin").read_bytes(), 0
        for group in model["weightsManifest"]:
            for entry in group["weights"]:
                stored = np.dtype(entry.get("quantization", entry)["dtype"])
                values = np.frombuffer(content, stored, math.prod(entry["shape"]), start)
                start += values.nbytes
                values = values.astype(entry["dtype"]).reshape(entry["shape"])
                self.constants[entry["name"]] = torch.from_numpy(values)

    def __call__(self, image: torch.Tensor, *wanted: str) -> list[torch.Tensor]:
        """Compute nodes for an image."""
        known = {name: image for name, node in self.nodes.items() if node["op"] == "Placeholder"}
        known |= self.constants
        with torch.no_grad():
            return [self._value(name, known) for name in wanted]

    def _value(self, name: str, known: dict[str, torch.Tensor]) -> torch.Tensor:
        if name not in known:
            node = self.nodes[name]
            inputs = [self._value(each, known) for each in node["input"]]
            known[name] = _compute(node, inputs)
        return known[name]


def _compute(node: dict, inputs: list[torch.Tensor]) -> torch.Tensor:
    op = node["op"]
    if op in SIMPLE:
        return SIMPLE[op](*inputs)
    if "Conv" in op and "oncat" not in op:
        return _convolve(node, *inputs)
    if op == "Mean":
        return inputs[0].mean(dim=inputs[1].tolist(), keepdim=True)
    if op == "ConcatV2":
        return torch.cat(inputs[:-1], dim=int(inputs[-1]))
    if op == "ResizeBilinear":
        return _resize(inputs[0], *inputs[1].tolist())
    raise NotImplementedError(op)


def _convolve(node, image, weights, bias=None):
    across, down = (int(node["attr"]["strides"]["list"]["i"][k]) for k in (2, 1))
    height, width, channels, multiple = weights.shape
    groups = 1
    if "Depthwise" in node["op"]:
        groups, weights = channels, weights.reshape(height, width, 1, channels * multiple)
    image = image.permute(0, 3, 1, 2)
    if _text(node["attr"]["padding"]["s"]) == "SAME":
        left_right = _around(image.shape[3], width, across)
        image = functional.pad(image, (*left_right, *_around(image.shape[2], height, down)))
    output = functional.conv2d(
        image, weights.permute(3, 2, 0, 1), stride=(down, across), groups=groups
    ).permute(0, 2, 3, 1)
    for fused in map(_text, node["attr"].get("fused_ops", {}).get("list", {}).get("s", [])):
        output = output + bias if fused == "BiasAdd" else ACTIVATIONS[fused](output)
    return output


def _around(size: int, kernel: int, stride: int) -> tuple[int, int]:
    total = max((math.ceil(size / stride) - 1) * stride + kernel - size, 0)
    return total // 2, total - total // 2


def _resize(image, height, width):
    """Resize as TensorFlow 1 does, where the first pixels of both pictures lie on each other."""
    for axis, size in ((1, height), (2, width)):
        old = image.shape[axis]
        place = torch.arange(size) * (old / size)
        low = place.floor().long()
        high = (low + 1).clamp(max=old - 1)
        share = (place - low).reshape([-1 if k == axis else 1 for k in range(4)])
        image = image.index_select(axis, low) * (1 - share) + image.index_select(axis, high) * share
    return image


def _text(encoded: str) -> str:
    return base64.b64decode(encoded).decode()
