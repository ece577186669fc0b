"""`coco-centernet`: a detector of COCO's 80 classes that others trained on photographs.

CenterNet (Zhou et al. 2019) on MobileNetV3: one map a class says where an object's centre lies, and
four more how far its box reaches from there.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from sada_gym.envs.detection.agent.graph import convert as convert_graph
from sada_gym.envs.detection.agent.steps import StepNetwork, load_steps, turned_square

SIDE = 512
"""Every image is resized to so many pixels a side, as `turned_square` does it."""

STRIDE = 4
"""Pixels per cell of the maps."""

TOP = 20
"""The best detections that are returned, beside the best of each class."""

FLOOR = 0.05
"""Other peaks count from this score on."""

_OUTPUTS = ("tower_0/CenternetHead/centernet_cls_output/BiasAdd", "tower_0/wh")

COCO_CLASSES = (
    *("person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat"),
    *("traffic light", "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat"),
    *("dog", "horse", "sheep", "cow", "elephant", "bear", "zebra", "giraffe", "backpack"),
    *("umbrella", "handbag", "tie", "suitcase", "frisbee", "skis", "snowboard", "sports ball"),
    *("kite", "baseball bat", "baseball glove", "skateboard", "surfboard", "tennis racket"),
    *("bottle", "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple"),
    *("sandwich", "orange", "broccoli", "carrot", "hot dog", "pizza", "donut", "cake", "chair"),
    *("couch", "potted plant", "bed", "dining table", "toilet", "tv", "laptop", "mouse"),
    *("remote", "keyboard", "cell phone", "microwave", "oven", "toaster", "sink"),
    *("refrigerator", "book", "clock", "vase", "scissors", "teddy bear", "hair drier"),
    "toothbrush",
)
"""The names of COCO's classes, in the order of the network's maps."""

OTHER_NAMES = {
    "aeroplane": "airplane",
    "diningtable": "dining table",
    "motorbike": "motorcycle",
}
"""COCO's names of our classes that have another one here."""


def with_our_names(labels: Mapping[str, int]) -> dict[str, int]:
    """Add our classes' names to a detector's labels by COCO's names."""
    ours = {name: labels[theirs] for name, theirs in OTHER_NAMES.items() if theirs in labels}
    return {**labels, **ours}


class CocoDetector(nn.Module):
    """Detects COCO's classes in images of any size from 32 pixels on.

    It is called as `Detector` is, and returns the same, but images may have any size. Label i + 1
    is COCO_CLASSES[i]. Every class has at least one detection in every image: that of its highest
    score, however low.
    """

    scores_every_class = True

    def __init__(self, network: StepNetwork) -> None:
        super().__init__()
        self.network = network
        self.labels = with_our_names({name: i + 1 for i, name in enumerate(COCO_CLASSES)})

    @property
    def architecture(self) -> str:
        """The name that a fingerprint holds beside the weights."""
        return f"sada_gym coco-centernet, side {SIDE}, {json.dumps(self.network.program)}"

    def maps(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Map an image (3, H, W) in [0, 1] to class logits (h, w, 80) and reach (h, w, 4).

        The reach is that from a cell's corner to the box's left, top, right and bottom, in pixels
        of the resized image. Both maps are turned by half a turn: cell (0, 0) is the last one.
        """
        logits, reach = self.network(turned_square(image, SIDE))
        return logits[0].permute(1, 2, 0), reach[0].permute(1, 2, 0)

    def forward(self, images: Sequence[Tensor]) -> list[dict[str, Tensor]]:
        """Detect: see the class.

        Raises:
            UserError: If an image is smaller than 32 pixels.
        """
        return [self._detect(image) for image in images]

    def _detect(self, image: Tensor) -> dict[str, Tensor]:
        height, width = image.shape[1:]
        maps, reach = self.maps(image)
        y, x, classes, logits = _peaks(maps)
        # 64 bits: the last of 32 would depend on how many scores there are
        scores = logits.double().sigmoid().float()
        rows, columns = reach.shape[:2]
        left, top, right, bottom = reach[y, x].unbind(1)
        x, y = STRIDE * (columns - 1 - x), STRIDE * (rows - 1 - y)
        corners = torch.stack([x - left, y - top, x + right, y + bottom], 1).clamp(0, SIDE)
        scale = torch.tensor([width, height, width, height]) / SIDE
        return {"boxes": corners * scale, "labels": classes + 1, "scores": scores}


def _peaks(maps: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return y, x, class and value, each (n,), of peaks of logits (h, w, k), highest first.

    They are the `TOP` highest and the highest of each class. A peak is as high as its 8 neighbours.
    """
    rows, columns, classes = maps.shape
    floor = maps.amax((0, 1)).clamp(max=math.log(FLOOR / (1 - FLOOR)))
    y, x, label = (maps >= floor).nonzero().unbind(1)
    value = maps[y, x, label]
    highest = value
    for down in (-1, 0, 1):
        for across in (-1, 0, 1):
            beside = (y + down).clamp(0, rows - 1), (x + across).clamp(0, columns - 1)
            highest = torch.maximum(highest, maps[(*beside, label)])
    peaks = (value == highest).nonzero()[:, 0]
    order = peaks[value[peaks].argsort(descending=True, stable=True)]
    place = torch.arange(len(order))
    first = torch.full((classes,), len(order)).scatter_reduce(0, label[order], place, "amin")
    order = order[(place < TOP) | (place == first[label[order]])]
    return y[order], x[order], label[order], value[order]


def convert(members: Mapping[str, bytes]) -> bytes:
    """Convert the package's JSON and weights into the detector's own file.

    Raises:
        FileError: If they hold another kind of network.
    """
    by_kind = {Path(name).suffix: content for name, content in members.items()}
    return convert_graph(by_kind[".json"], by_kind[".bin"], _OUTPUTS)


def load(path: Path) -> CocoDetector:
    """Read the file that `convert` made.

    Raises:
        FileError: If it holds something else.
    """
    return CocoDetector(load_steps(path, "coco-centernet")).eval().requires_grad_(False)
