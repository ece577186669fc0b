"""Classifiers and detectors as the application calls them: one image at a time.

An image alone gives the same answer whatever else is looked at. Networks may be torch modules,
TorchScript, ONNX or functions; what they tell is checked and becomes `Found`.
"""

from __future__ import annotations

import ast
import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.agents.agent_files import ONNX, TORCHSCRIPT
from sada_gym.agents.contract import Task
from sada_gym.agents.exported import (
    MAX_MODEL_BYTES,
    ExportedFile,
    onnx_session,
    torchscript_module,
)
from sada_gym.agents.identity import check_finite_weights, fingerprint
from sada_gym.agents.remote.messages import HelloImages
from sada_gym.agents.remote.places import place_of
from sada_gym.envs.checks import check_evaluation_mode
from sada_gym.envs.images.answers import CONVENTIONS, FAINT, Found, classified, detected
from sada_gym.envs.images.remote import RemoteModel
from sada_gym.errors import UserError, UserTypeError, check_known, explained
from sada_gym.foundations.arrays import Bytes, Floats
from sada_gym.foundations.cards import fetchable
from sada_gym.foundations.determinism import one_thread
from sada_gym.foundations.files import read_file
from sada_gym.foundations.lazy import load
from sada_gym.foundations.serve_environment import PROTOCOL

IMAGENET_MEAN, IMAGENET_SPREAD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""The colours that torchvision's and most other classifiers take for zero and one."""

_IMAGENET_SIZE = 224
_OVERLAP = 0.7  # of two boxes that mean one object: what YOLO's own programs take
_GREY = 114  # what YOLO's own programs fill an image up with


@dataclass(frozen=True)
class Preparation:
    """How an image becomes a network's input.

    Attributes:
        size: Its sides in px; None leaves the image as it is.
        imagenet: Whether ImageNet's mean and spread are zero and one.
    """

    size: int | None = None
    imagenet: bool = False


class Model:
    """A classifier or a detector.

    Args:
        network: A torch module, or a function. A classifier takes (1, 3, height, width) float32; a
            detector takes a list of (3, height, width) float32 in [0, 1], as torchvision's do.
        task: What it does.
        preparation: What a classifier gets.
        device: Where it computes: `cpu`, `cuda`, `cuda:1`.
        weights: A hash of what the network does; None takes its class and weights.

    Attributes:
        names: The numbers of its classes by name; empty where they are unknown.

    Raises:
        UserError: If it is in training mode, or there is no such device.
    """

    def __init__(
        self,
        network: Any,
        task: Task,
        preparation: Preparation,
        device: str = "cpu",
        weights: str | None = None,
    ) -> None:
        if not callable(network):
            raise UserTypeError(
                "Expected agent as a file, a name or a network that can be called, got "
                f"{type(network).__name__}."
            )
        check_evaluation_mode(network, "model")
        check_finite_weights(network)
        self.task, self.names = task, _names(network)
        self.network, self.device = _on_device(network, device), device
        self._weights = fingerprint(network) if weights is None else weights
        self._preparation = preparation

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over its weights and how it is used; None where the weights are unknown."""
        if self._weights is None:
            return None
        used = f"{self._weights} {self.task} {self._preparation} {self.device.partition(':')[0]}"
        return hashlib.sha256(used.encode()).hexdigest()

    def found(self, image: Bytes) -> Found:
        """Tell what is in an image (height, width, 3) uint8.

        Raises:
            UserError: If the network cannot take it, or breaks its convention.
        """
        import torch

        expected = f"Expected an answer of the model to an image of {image.shape}"
        with one_thread(), torch.inference_mode(), explained(expected, CONVENTIONS[self.task]):
            if self.task == "detect":
                pixels = torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))
                return detected(self.network([(pixels.float() / 255.0).to(self.device)]))
            given = torch.from_numpy(prepared(image, self._preparation)).to(self.device)
            return classified(self.network(given))


def prepared(image: Bytes, preparation: Preparation) -> npt.NDArray[np.float32]:
    """Return an image as (1, 3, height, width) float32."""
    import cv2

    if preparation.size is not None:
        size = preparation.size, preparation.size
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    values = image.transpose(2, 0, 1)[None].astype(np.float32) / np.float32(255.0)
    if preparation.imagenet:
        mean, spread = (np.array(part, np.float32) for part in (IMAGENET_MEAN, IMAGENET_SPREAD))
        values = (values - mean[:, None, None]) / spread[:, None, None]
    return np.ascontiguousarray(values)


class OnnxModel(ExportedFile):
    """A classifier or a detector of an ONNX file.

    It takes one input, (1, 3, height, width) or (1, height, width, 3), floats in [0, 1] or uint8. A
    classifier's output is (1, K). A detector's are boxes, labels and scores, or one of YOLO's
    heads: (1, N, 6) with x0 y0 x1 y1 score class, (1, 4 + K, N) with x y width height and the
    scores of K classes, or (1, N, 5 + K) with an objectness before them.

    Args:
        path: The file.
        preparation: What a classifier gets; the file may fix the size.

    Raises:
        FileError: If it is no ONNX file.
        UserError: If it has another input.
    """

    packages = ("onnxruntime",)
    beside = ".data"

    def __init__(self, path: Path, preparation: Preparation) -> None:
        self._preparation = preparation
        super().__init__(path)

    def _open(self) -> None:
        model, *weights = self._contents
        self._session = onnx_session(model, self.path, weights)
        inputs = self._session.get_inputs()
        shape = [*inputs[0].shape]
        self._first = len(shape) == 4 and shape[3] != 3
        if len(inputs) != 1 or len(shape) != 4 or 3 not in (shape[1], shape[3]):
            raise UserError(
                f"Expected one input (1, 3, height, width) in {self.path}, got "
                f"{[each.shape for each in inputs]}. Export the model for images of three colours."
            )
        sides = shape[2:] if self._first else shape[1:3]
        self._sides = (*sides,) if all(isinstance(side, int) for side in sides) else None
        self._input = inputs[0].name
        self._whole = inputs[0].type == "tensor(uint8)"
        self._half = inputs[0].type == "tensor(float16)"
        shapes = [len(each.shape) for each in self._session.get_outputs()]
        self.task: Task = "classify" if shapes == [2] else "detect"
        self.names = _yolo_names(self._session.get_modelmeta().custom_metadata_map)

    @property
    def fingerprint(self) -> str:
        """SHA-256 over the files and how they are used."""
        used = b"".join(self._contents) + str(self._preparation).encode()
        return hashlib.sha256(used).hexdigest()

    def found(self, image: Bytes) -> Found:
        """Tell what is in an image, see `Model.found`."""
        import cv2

        expected = f"Expected an answer of {self.path} to an image of {image.shape}"
        with explained(expected, CONVENTIONS[self.task]):
            if self.task == "classify":
                size, mapped = self._preparation.size, image
                if self._sides is not None:
                    rows, columns = self._sides
                    mapped = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
                    size = None
                given = Preparation(size, self._preparation.imagenet)
                return classified(self._outputs(prepared(mapped, given))[0])
            mapped, factor, corner = self._letterboxed(image)
            outputs = self._outputs(prepared(mapped, Preparation()))
            boxes, labels, scores = decoded(outputs)
            corners = (boxes - np.tile(corner, 2)) / factor
            rows, columns = image.shape[:2]
            limits = np.array([columns, rows, columns, rows])
            corners = corners.clip(0.0, limits)
            return detected([{"boxes": corners, "labels": labels, "scores": scores}])

    def _outputs(self, values: npt.NDArray[np.float32]) -> list[Any]:
        given = values if self._first else values.transpose(0, 2, 3, 1)
        if self._whole:
            given = np.rint(255.0 * given).astype(np.uint8)
        elif self._half:
            given = given.astype(np.float16)
        outputs: list[Any] = self._session.run(None, {self._input: np.ascontiguousarray(given)})
        return outputs

    def _letterboxed(self, image: Bytes) -> tuple[Bytes, float, Floats]:
        """Fit an image into the input's sides and fill it up; return the factor and its corner."""
        import cv2

        if self._sides is None:
            return image, 1.0, np.zeros(2)
        rows, columns = self._sides
        factor = min(rows / image.shape[0], columns / image.shape[1])
        height, width = (max(1, round(side * factor)) for side in image.shape[:2])
        top, left = (rows - height) // 2, (columns - width) // 2
        filled = np.full((rows, columns, 3), _GREY, np.uint8)
        filled[top : top + height, left : left + width] = cv2.resize(image, (width, height))
        return filled, factor, np.array([left, top], np.float64)


def decoded(outputs: Sequence[Any]) -> tuple[Floats, npt.NDArray[np.int64], Floats]:
    """Return boxes (N, 4), labels (N,) and scores (N,) of a detector's outputs, see `OnnxModel`.

    Raises:
        UserError: If they are of none of these shapes.
    """
    import cv2

    arrays = [np.asarray(output) for output in outputs]
    if len(arrays) == 1 and arrays[0].ndim == 3 and len(arrays[0]) == 1:
        rows = arrays[0][0].astype(np.float64)
        if rows.shape[1] == 6:
            return rows[:, :4], rows[:, 5].astype(np.int64), rows[:, 4].clip(0.0, 1.0)
        if rows.shape[0] < rows.shape[1]:
            rows, objectness = rows.T, 1.0
            shares = rows[:, 4:]
        else:
            objectness, shares = rows[:, [4]], rows[:, 5:]
        shares = (shares * objectness).clip(0.0, 1.0)
        labels, scores = shares.argmax(axis=1), shares.max(axis=1, initial=0.0)
        likely = np.flatnonzero(scores >= FAINT)
        corner = rows[likely, :2] - rows[likely, 2:4] / 2.0
        sized = np.concatenate([corner, rows[likely, 2:4]], axis=1)
        kept = cv2.dnn.NMSBoxesBatched(
            sized.tolist(), scores[likely].tolist(), labels[likely].tolist(), FAINT, _OVERLAP
        )
        chosen = likely[np.asarray(kept, np.intp)] if len(kept) else likely[:0]
        half = rows[chosen, 2:4] / 2.0
        boxes = np.concatenate([rows[chosen, :2] - half, rows[chosen, :2] + half], axis=1)
        return boxes, labels[chosen], scores[chosen]
    flat = [
        array.reshape(array.shape[1:]) if array.shape[:1] == (1,) else array for array in arrays
    ]
    boxed = [array for array in flat if array.ndim == 2 and array.shape[1] == 4]
    lists = [array for array in flat if array.ndim == 1]
    whole = [array for array in lists if array.dtype.kind in "iu"]
    sure = [array for array in lists if array.dtype.kind == "f"]
    if len(boxed) == len(whole) == len(sure) == 1:
        return boxed[0].astype(np.float64), whole[0].astype(np.int64), sure[0].astype(np.float64)
    raise UserError(
        "Expected boxes, labels and scores as outputs, or one head of YOLO's, got outputs of "
        f"{[array.shape for array in arrays]}. Export the model with its decoding."
    )


def find_model(
    agent: Any,
    task: Task | None,
    preparation: Preparation,
    device: str,
    *,
    timeout_s: float = 300.0,
) -> Any:
    """Return the model that `agent=` means.

    Args:
        agent: The name of a fetched agent, `torchvision:NAME`, a file of ONNX or TorchScript, a
            torch module or a function; an address or a command of an agent's process; or an object
            with `task`, `names`, `fingerprint` and `found`, as it is.
        task: What it does; None where the agent itself says it.
        preparation: What a classifier gets.
        device: Where it computes.
        timeout_s: How long an agent in a separate process may take for an answer.

    Raises:
        UserError: If there is no such agent, or nobody says what it does.
    """
    check_known("task", [] if task is None else [task], ["classify", "detect"])
    if (place := place_of(agent)) is not None:
        size, imagenet = preparation.size, preparation.imagenet
        used: Any = {"task": task, "input_size": size, "imagenet": imagenet, "device": device}
        with explained(f"Expected imagenet= as true or false and device= as a name for {place}"):
            hello = HelloImages(number=0, protocol=PROTOCOL, **used)
        return RemoteModel(place, hello, timeout_s)
    if isinstance(agent, str | Path):
        return _named(str(agent), task, preparation, device)
    if all(hasattr(agent, name) for name in ("task", "names", "found")):
        return agent
    if task is None:
        raise UserError(
            "Expected task='classify' or task='detect' for a network without labels, got none. Say "
            "what it does."
        )
    return Model(agent, task, preparation, device)


def _named(agent: str, task: Task | None, preparation: Preparation, device: str) -> Any:
    if agent in (others := fetchable()):
        row = others[agent]
        network = load(row.loader)(load("sada_gym.foundations.fetch:fetched")(row))
        if hasattr(network, "logits"):  # it is called as a detector elsewhere
            return Model(_Logits(network), "classify", Preparation(), device, fingerprint(network))
        return Model(network, "detect", Preparation(), device)
    source, _, name = agent.partition(":")
    if source == "torchvision":
        network, is_detector = load("sada_gym.envs.detection.agent.from_torchvision:load_any")(name)
        if not is_detector and preparation == Preparation():
            preparation = Preparation(_IMAGENET_SIZE, imagenet=True)
        return Model(network, "detect" if is_detector else "classify", preparation, device)
    path = Path(os.path.expanduser(agent))
    suffix = path.suffix.lower()
    if suffix in ONNX:
        return OnnxModel(path, preparation)
    if suffix not in TORCHSCRIPT:
        files = ", ".join((*ONNX, *TORCHSCRIPT))
        raise UserError(
            f"Expected an agent among {', '.join(others)}, torchvision:NAME, or a file {files}, "
            f"got {agent!r}."
        )
    if task is None:
        raise UserError(
            f"Expected task='classify' or task='detect' for {path}, got none. Say what it does."
        )
    content = read_file(path, MAX_MODEL_BYTES)
    module = torchscript_module(content, path)
    return Model(module, task, preparation, device, hashlib.sha256(content).hexdigest())


class _Logits:
    """The classifier within a network that is called as a detector."""

    def __init__(self, network: Any) -> None:
        self._network = network

    def to(self, device: str) -> _Logits:
        return _Logits(self._network.to(device))

    def __call__(self, images: Any) -> Any:
        return self._network.logits(images[0])[None]


def _names(network: Any) -> dict[str, int]:
    """Return the classes' numbers by name: a network has them as `labels` or, YOLO's, `names`."""
    labels, names = getattr(network, "labels", None), getattr(network, "names", None)
    if isinstance(labels, Mapping):
        return {str(name): int(number) for name, number in labels.items()}
    if isinstance(names, Mapping):
        return {str(name): int(number) for number, name in names.items()}
    return {}


def _yolo_names(metadata: Mapping[str, str]) -> dict[str, int]:
    try:
        names = ast.literal_eval(metadata.get("names", ""))
        return {str(name): int(number) for number, name in dict(names).items()}
    except (ValueError, SyntaxError, TypeError):
        return {}


def _on_device(network: Any, device: str) -> Any:
    if device == "cpu":
        return network
    import torch

    with explained(f"Expected device='cpu' or 'cuda', got {device!r}"):
        kind = torch.device(device).type
    if kind != "cuda" or not torch.cuda.is_available():
        raise UserError(
            f"Expected a device that is here, got {device!r}: torch sees "
            f"{torch.cuda.device_count()} GPUs. Leave device= out."
        )
    torch.backends.cudnn.deterministic, torch.backends.cudnn.benchmark = True, False
    return network.to(device)
