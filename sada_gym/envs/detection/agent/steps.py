"""A network given as a list of steps: convolutions and what lies between them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from sada_gym.agents.weights import WeightsFile, read_weights
from sada_gym.errors import UserError

SMALLEST = 32
"""Images with fewer pixels a side are refused."""

_ACTIVATIONS: Mapping[str, Callable[[Tensor], Tensor]] = {
    "": lambda x: x,
    "relu": functional.relu_,
    "relu6": lambda x: functional.hardtanh_(x, 0, 6),
    "sigmoid": torch.sigmoid_,
    "hardswish": lambda x: functional.hardswish(x, inplace=True),
    "hardsigmoid": lambda x: functional.hardsigmoid(x, inplace=True),
}


class StepNetwork(nn.Module):
    """Computes the steps that `graph.convert` laid out, with images in the order channels last.

    Args:
        program: `steps`, each with its `op`, the numbers of its `inputs` and its settings; and
            `outputs`, each the number of a step and a factor.
        weights: The kernels (out, in / groups, k, k) and biases (out,) by `STEP.weight` and
            `STEP.bias`.
    """

    architecture: ClassVar[str] = "sada_gym steps"

    def __init__(self, program: Mapping[str, Any], weights: Mapping[str, Tensor]) -> None:
        super().__init__()
        self.program = program
        for name, value in weights.items():
            kept = value.contiguous(memory_format=torch.channels_last) if value.ndim == 4 else value
            self.register_buffer(name.replace(".", "_"), kept)
        steps = program["steps"]
        last = {i: k for k, step in enumerate(steps) for i in step.get("inputs", ())}
        kept_for_ever = {step for step, _ in program["outputs"]}
        self._dies: list[set[int]] = [
            {i for i in step.get("inputs", ()) if last[i] == k} - kept_for_ever
            for k, step in enumerate(steps)
        ]

    def forward(self, image: Tensor) -> list[Tensor]:
        """Map images (n, c, h, w), turned by half a turn, to the outputs, turned as well.

        h and w are multiples of what all strides make together.
        """
        values: dict[int, Tensor] = {0: image.contiguous(memory_format=torch.channels_last)}
        for number, step in enumerate(self.program["steps"]):
            if number:
                values[number] = self._compute(number, step, values)
                for dead in self._dies[number]:
                    del values[dead]
        return [values[step] * factor for step, factor in self.program["outputs"]]

    def _compute(
        self, number: int, step: Mapping[str, Any], values: Mapping[int, Tensor]
    ) -> Tensor:
        inputs, op = [values[i] for i in step["inputs"]], step["op"]
        first = inputs[0]
        if op == "convolution":
            weight = getattr(self, f"{number}_weight")
            found = functional.conv2d(
                first,
                weight,
                getattr(self, f"{number}_bias", None),
                step["stride"],
                weight.shape[-1] // 2,
                groups=step["groups"],
            )
            return _ACTIVATIONS[step["activation"]](found)
        if op == "mean":
            return first.mean((2, 3), keepdim=True)
        if op == "concat":
            return torch.cat(inputs, 1)
        if op == "double":
            return _double(first)
        # the memory of a value that nothing else needs takes the result
        dying = [i for i in step["inputs"] if i in self._dies[number] and i]
        largest = max((values[i] for i in dying), key=Tensor.numel, default=None)
        if op == "add":
            fits = largest is not None and largest.shape == first.shape == inputs[1].shape
            return torch.add(first, inputs[1], alpha=step["alpha"], out=largest if fits else None)
        if op == "multiply":
            fits = largest is not None and largest.numel() == max(map(Tensor.numel, inputs))
            return torch.mul(first, inputs[1], out=largest if fits else None)
        return _ACTIVATIONS[op](first if dying else first.clone())


def load_steps(path: Path, name: str) -> StepNetwork:
    """Read the network of the agent `name` from its file.

    Raises:
        FileError: If the file holds something else.
    """
    file = WeightsFile(path, f"the weights of {name}", "detector", f"sada_gym fetch {name}")
    weights, program = read_weights(file)
    if program is None:
        raise file.error(", got a file that does not say how its network is built")
    return StepNetwork(json.loads(program), weights)


def turned_square(image: Tensor, side: int) -> Tensor:
    """Resize an image (3, h, w) in [0, 1] to (1, 3, side, side) in [0, 255], turned by half a turn.

    It is stretched where it is not square. Resizing is bilinear, with the pixels' centres on each
    other, and takes the average of all that a pixel covers where the image is larger.

    Raises:
        UserError: If the image is smaller than 32 pixels.
    """
    height, width = image.shape[1:]
    if min(height, width) < SMALLEST:
        raise UserError(
            f"Expected images of at least {SMALLEST} pixels a side for this detector, got "
            f"{height} x {width}. Set image_size to at least {SMALLEST}."
        )
    turned = (255 * image.flip(1, 2)[None]).contiguous(memory_format=torch.channels_last)
    larger = max(height, width) > side
    return functional.interpolate(turned, (side, side), mode="bilinear", antialias=larger)


def _double(image: Tensor) -> Tensor:
    """Resize (n, c, h, w) to twice its size: each pixel, and before it the middle to the last."""
    edged = functional.pad(image, (1, 0, 1, 0), mode="replicate")
    size = [2 * side + 1 for side in image.shape[2:]]
    return functional.interpolate(edged, size, mode="bilinear", align_corners=True)[:, :, 1:, 1:]
