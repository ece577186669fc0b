"""`efficientnet-lite0`: a classifier that others trained on ImageNet, called as a detector is.

EfficientNet-Lite0 (https://github.com/tensorflow/tpu, models/official/efficientnet/lite) is
EfficientNet-B0 (Tan & Le 2019) without gates and with ReLU6.
"""

from __future__ import annotations

import io
import json
import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.numpy import save
from torch import Tensor, nn

from sada_gym.envs.detection.agent.steps import StepNetwork, load_steps, turned_square
from sada_gym.errors import FileError

SIDE = 224
"""Every image is resized to so many pixels a side, as `turned_square` does it."""

MIDDLE, SPREAD = 127.0, 128.0
"""What the network takes for zero and one, of colours up to 255."""

SYNONYMS: Mapping[str, Mapping[int, str]] = {
    "aeroplane": {404: "airliner", 895: "warplane"},
    "bench": {703: "park bench"},
    "bicycle": {444: "bicycle-built-for-two", 671: "mountain bike"},
    "boat": {
        **{472: "canoe", 484: "catamaran", 510: "container ship", 554: "fireboat"},
        **{576: "gondola", 625: "lifeboat", 628: "liner", 780: "schooner", 814: "speedboat"},
        **{871: "trimaran", 914: "yawl"},
    },
    "bottle": {
        **{440: "beer bottle", 720: "pill bottle", 737: "pop bottle", 898: "water bottle"},
        907: "wine bottle",
    },
    "bus": {654: "minibus", 779: "school bus", 874: "trolleybus"},
    "car": {
        **{407: "ambulance", 436: "beach wagon", 468: "cab", 511: "convertible", 609: "jeep"},
        **{627: "limousine", 656: "minivan", 661: "Model T", 734: "police van", 751: "racer"},
        817: "sports car",
    },
    "chair": {
        **{423: "barber chair", 559: "folding chair", 765: "rocking chair", 857: "throne"},
    },
    "diningtable": {532: "dining table"},
    "motorbike": {665: "moped", 670: "motor scooter"},
    "train": {
        **{466: "bullet train", 547: "electric locomotive", 565: "freight car"},
        **{705: "passenger car", 820: "steam locomotive", 829: "streetcar"},
    },
    "truck": {
        **{555: "fire engine", 569: "garbage truck", 675: "moving van", 717: "pickup"},
        **{864: "tow truck", 867: "trailer truck"},
    },
}
"""The classes of ImageNet, by number, that mean one of ours."""

_BLOCKS = (  # expansion, output channels, repeats, first stride, kernel
    *((1, 16, 1, 1, 3), (6, 24, 2, 2, 3), (6, 40, 2, 2, 5), (6, 80, 3, 2, 3)),
    *((6, 112, 3, 1, 5), (6, 192, 4, 2, 5), (6, 320, 1, 1, 3)),
)
_EPSILON = 1e-3


class ImagenetClassifier(nn.Module):
    """Scores how likely an image of any size from 32 pixels shows each of detection's 12 classes.

    It is called as `Detector` is, and returns the same, with one entry for each class; every box is
    the whole image. A class's score is the sum of the softmax over its `SYNONYMS`. Label i + 1 is
    the i-th class of `SYNONYMS`.
    """

    def __init__(self, network: StepNetwork) -> None:
        super().__init__()
        self.network = network
        self.labels = {name: i + 1 for i, name in enumerate(SYNONYMS)}

    @property
    def architecture(self) -> str:
        """The name that a fingerprint holds beside the weights."""
        synonyms = [list(numbers) for numbers in SYNONYMS.values()]
        return f"sada_gym efficientnet-lite0, side {SIDE}, {synonyms}, {self.network.program}"

    def logits(self, image: Tensor) -> Tensor:
        """Map an image (3, H, W) in [0, 1] to the logits (1000,) of ImageNet's classes."""
        (found,) = self.network((turned_square(image, SIDE) - MIDDLE) / SPREAD)
        logits: Tensor = found.flatten()
        return logits

    def forward(self, images: Sequence[Tensor]) -> list[dict[str, Tensor]]:
        """Classify: see the class.

        Raises:
            UserError: If an image is smaller than 32 pixels.
        """
        return [self._classify(image) for image in images]

    def _classify(self, image: Tensor) -> dict[str, Tensor]:
        shares = self.logits(image).double().softmax(0)
        sums = torch.stack([shares[list(numbers)].sum() for numbers in SYNONYMS.values()])
        scores, order = sums.clamp(max=1).float().sort(descending=True, stable=True)
        height, width = image.shape[1:]
        box = torch.tensor([0.0, 0.0, width, height])
        return {"boxes": box.expand(len(scores), 4), "labels": order + 1, "scores": scores}


def convert(members: Mapping[str, bytes]) -> bytes:
    """Convert the package's weights, a torch file, into a file of steps; nothing is unpickled.

    Raises:
        FileError: If the file holds something else.
    """
    (content,) = members.values()
    try:
        weights = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        return _StepWriter({name: value.numpy() for name, value in weights.items()}).file()
    except (RuntimeError, pickle.UnpicklingError, EOFError, LookupError, AttributeError) as error:
        raise FileError(
            f"Expected the weights of an EfficientNet-Lite0, got {type(error).__name__}: {error}."
        ) from error


class _StepWriter:
    """Lays the network out as steps, with batch normalisation folded into convolutions."""

    def __init__(self, weights: Mapping[str, np.ndarray[Any, Any]]) -> None:
        self._weights = weights
        self._steps: list[dict[str, Any]] = [{"op": "image"}]
        self._kept: dict[str, np.ndarray[Any, Any]] = {}

    def file(self) -> bytes:
        x = self._convolution("_conv_stem", "_bn0", 0, "relu6", stride=2)
        inputs, number = 32, 0
        for expansion, outputs, repeats, first_stride, _ in _BLOCKS:
            for repeat in range(repeats):
                stride = 1 if repeat else first_stride
                before, block = x, f"_blocks.{number}."
                if expansion > 1:
                    x = self._convolution(f"{block}_expand_conv", f"{block}_bn0", x, "relu6")
                wide, name = inputs * expansion, f"{block}_depthwise_conv"
                x = self._convolution(name, f"{block}_bn1", x, "relu6", stride, wide)
                x = self._convolution(f"{block}_project_conv", f"{block}_bn2", x)
                if stride == 1 and inputs == outputs:
                    x = self._step("add", x, before, alpha=1.0)
                inputs, number = outputs, number + 1
        x = self._convolution("_conv_head", "_bn1", x, "relu6")
        x = self._step("mean", x)
        classes = self._weights["_fc.weight"][:, :, None, None]
        x = self._plain(classes, self._weights["_fc.bias"], x, "", 1, 1)
        program = {"steps": self._steps, "outputs": [[x, 1.0]]}
        return save(self._kept, {"architecture": json.dumps(program, sort_keys=True)})

    def _convolution(
        self, name: str, norm: str, x: int, activation: str = "", stride: int = 1, groups: int = 1
    ) -> int:
        mean, variance, scale, bias = (
            self._weights[f"{norm}.{part}"].astype(np.float64)
            for part in ("running_mean", "running_var", "weight", "bias")
        )
        factor = scale / np.sqrt(variance + _EPSILON)
        kernel = self._weights[f"{name}.weight"] * factor[:, None, None, None]
        return self._plain(kernel, bias - mean * factor, x, activation, stride, groups)

    def _plain(
        self,
        kernel: np.ndarray[Any, Any],
        bias: np.ndarray[Any, Any],
        x: int,
        activation: str,
        stride: int,
        groups: int,
    ) -> int:
        number = str(len(self._steps))
        turned = kernel[:, :, ::-1, ::-1].astype(np.float32)
        self._kept[f"{number}.weight"] = np.ascontiguousarray(turned)
        self._kept[f"{number}.bias"] = bias.astype(np.float32)
        return self._step("convolution", x, stride=stride, groups=groups, activation=activation)

    def _step(self, op: str, *inputs: int, **settings: Any) -> int:
        self._steps.append({"op": op, "inputs": list(inputs), **settings})
        return len(self._steps) - 1


def load(path: Path) -> ImagenetClassifier:
    """Read the file that `convert` made; raise `FileError` if it holds something else."""
    return ImagenetClassifier(load_steps(path, "efficientnet-lite0")).eval().requires_grad_(False)
