"""Your own model under attack, on your own images, under conditions that mu sets."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt
from PIL import Image

from sada_gym.agents.contract import Task, identity_of
from sada_gym.agents.remote.peer import Peer
from sada_gym.application import Application, Scored, check_declared, validate_world
from sada_gym.envs.checks import check_number
from sada_gym.envs.images.answers import Found, matched, visible
from sada_gym.envs.images.conditions import (
    Condition,
    Developed,
    check_opencv,
    developed,
    find_conditions,
)
from sada_gym.envs.images.dataset import Objects, image_set
from sada_gym.envs.images.geometry import moved_boxes
from sada_gym.envs.images.models import Preparation, find_model
from sada_gym.envs.images.optics import Values
from sada_gym.envs.images.pictures import LEGENDS, drawn, fitted
from sada_gym.errors import UserError, check_integer, check_known, check_plain
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.behaviour import MOST_NAMED, Behaviour
from sada_gym.foundations.drawing import beside
from sada_gym.foundations.figures import percent
from sada_gym.foundations.frames import Frame, LegendEntry
from sada_gym.parameters import Mu, ParameterSpace

Score = Literal["right", "confidence", "f1"]
"""How answers are scored, see `ImageApplication`."""

SURER = 0.15
"""Without labels, objects count that the model finds in the untouched image by so much more than
the confidence that counts later; else the slightest change would lose some."""
_CLEAN_IMAGES = 64
"""So many untouched images show what is usual."""
_ABOVE_CHANCE = 0.1
_FILM = 24


class Seen(NamedTuple):
    """One image of a world: what became of it, what counts in it, and what the model told.

    Attributes:
        number: Its number in the data set; `place` is that in the world.
        right: (n,) of what counts, whether the model told it.
        extra: How many of its answers are of no object.
    """

    number: int
    developed: Developed
    truth: Objects
    place: int
    found: Found
    right: npt.NDArray[np.bool_]
    extra: int


class ImageApplication(Application):
    """A frozen classifier or detector on images under camera and weather conditions.

    In a world, mu sets the conditions, and the seed draws `batch` images and all that is random in
    the conditions. Rotation, zoom and distortion move the objects with the image. Objects of which
    less than half remains in the picture do not count.

    Args:
        images: A folder, a list of files, or arrays (height, width, 3) uint8.
        agent: An ONNX or TorchScript file, `torchvision:NAME`, the name of a fetched agent, a torch
            module, or a function. It gets a float32 tensor (1, 3, height, width) in [0, 1], and
            returns (1, classes) scores. As torchvision's, a detector gets a list of (3, height,
            width), and returns a list of `{"boxes", "labels", "scores"}`. For an agent in a
            separate process: its address, `"tcp://127.0.0.1:7788"`, or a command (list of texts).
        labels: What is in the images: COCO's JSON, a folder of YOLO's text files, a class for each
            image, or `boxes` and `labels` for each. None takes the names of the images' folders as
            classes, if all images lie in such folders; otherwise the model's own answers on the
            untouched images count as true, and a failure is a changed answer.
        conditions: `common`, `camera`, `weather`, `all`; a list of names and your own conditions;
            or a dictionary from a name to True, or to a narrower range of its first parameter.
        task: `classify` or `detect`, if it does not follow from the labels or the agent.
        classes: The names of the labels' classes, from 0.
        only: The names of the classes that count; None takes all.
        score: `right`, the share of images classified correctly, or of objects found; `confidence`,
            a classifier's mean probability of the right class; `f1`, which also counts a detector's
            false alarms.
        fooling_threshold: The agent is fooled if the score is at most this. The default is halfway
            between the score on the untouched images and chance.
        batch: The number of images in a world.
        sample_size: Number of test samples drawn from a trained adversary (M in the paper).
        confidence: Detections with a lower score do not count.
        iou: A detection finds an object if they overlap at least this much.
        input_size: The side in px to which images are resized for a classifier; None keeps theirs.
        imagenet: Whether to normalise a classifier's input by ImageNet's mean and deviation.
        device: Where a torch module computes: `cpu` or `cuda`.
        agent_timeout: Seconds that a separate agent may take to start, and for each answer.
        name: The application's name in reports.
        agent_id: Names the agent where scores are stored; by default a hash of its weights.
        skip_unreadable: Skip images that cannot be read, with a warning that counts them.

    Raises:
        UserError: If there are no images, one cannot be read, labels and model do not fit, or the
            model is hardly better than chance on the untouched images.
    """

    render_fps = 8
    combines = True
    packages = ("torch", "opencv-python-headless", "opencv-python", "pillow")

    def __init__(
        self,
        images: str | Path | Sequence[Any],
        *,
        agent: Any,
        labels: Any = None,
        conditions: str | Sequence[str | Condition] | Mapping[str, Any] = "common",
        task: Task | None = None,
        classes: Sequence[str] | None = None,
        only: Sequence[str] | None = None,
        score: Score = "right",
        fooling_threshold: float | None = None,
        batch: int = 8,
        sample_size: int = 100,
        confidence: float = 0.25,
        iou: float = 0.5,
        input_size: int | None = None,
        imagenet: bool = False,
        device: str = "cpu",
        agent_timeout: float = 300.0,
        name: str = "Images",
        agent_id: str | None = None,
        skip_unreadable: bool = False,
    ) -> None:
        check_opencv()
        check_integer("batch", batch, 1, 10_000)
        check_integer("sample_size", sample_size, 1, 2**53)
        check_number("confidence", confidence, 0.0, 1.0)
        check_number("iou", iou, 0.0, 1.0)
        check_known("score", [score], get_args(Score))
        if input_size is not None:
            check_integer("input_size", input_size, 2, 10_000)
        check_plain("name", name)
        self.name, self.sample_size = name, sample_size  # type: ignore[misc]
        self.images = image_set(images, labels, classes=classes, skip_unreadable=skip_unreadable)
        check_number("agent_timeout", agent_timeout, 1e-3, 1e6)
        preparation = Preparation(input_size, imagenet)
        known = self.images.task or task
        self.agent = find_model(agent, known, preparation, device, timeout_s=agent_timeout)
        self.agent_name = agent_id or getattr(self.agent, "name", None) or name_of(agent)
        self._agent_id = agent_id
        self.task: Task = self.agent.task
        self._check_task(score)
        self._score_kind: Score = score
        self._confidence, self._iou = float(confidence), float(iou)
        self.batch = min(batch, len(self.images))
        self.conditions = find_conditions(conditions)
        self.parameters = ParameterSpace(
            *(parameter for each in self.conditions for parameter in each.parameters)
        )
        usual = [value for each in self.conditions for value in each.nominal]
        self.nominal = self.parameters.normalised(usual)
        self._only = None if only is None else self._numbers_of(only)
        self._truths: dict[int, Objects] = {}
        chance = 1.0 / self._count_classes() if self.task == "classify" else 0.0
        self.clean_score = self._clean()
        if self.clean_score < chance + _ABOVE_CHANCE:
            raise UserError(
                f"Expected a model that is better than chance on the untouched images, got "
                f"{self.agent_name} with {percent(self.clean_score)} right: there is nothing to "
                "attack. Check that labels=, classes= and input_size= are those of the model."
            )
        halfway = round((self.clean_score + chance) / 2.0, 2)
        self.fooling_threshold = halfway if fooling_threshold is None else fooling_threshold
        check_declared(self)

    def _check_task(self, score: Score) -> None:
        known = self.images.task
        if known is not None and known != self.task:
            raise UserError(
                f"Expected labels for a model that is there to {self.task}, got labels to {known}. "
                "Pass labels of the other kind, or labels=False."
            )
        fits = ("right", "confidence") if self.task == "classify" else ("right", "f1")
        check_known(f"score of a model that is there to {self.task}", [score], fits)

    def _count_classes(self) -> int:
        """Count a classifier's classes; raise `UserError` if the labels have others."""
        count = len(self.agent.found(self.images.image(0)).probabilities)
        named = self.images.classes
        if named and self.agent.names:  # they are joined by their names
            return count
        most = max((int(label.classes[0]) for label in self.images.labels or ()), default=0)
        if most >= count or (named and len(named) != count):
            got = f"{len(named)}: {', '.join([*named.values()][:3])}" if named else f"class {most}"
            raise UserError(
                f"Expected labels of the {count} classes that {self.agent_name} tells apart, got "
                f"{got}. Name folders by the model's numbers of classes, or pass these as labels=."
            )
        return count

    def _numbers_of(self, only: Sequence[str]) -> set[int]:
        """Return the model's numbers of classes by name."""
        names = self.agent.names or {name: i for i, name in self.images.classes.items()}
        check_known("class", only, [*names])
        return {names[name] for name in only}

    def _labelled(self, i: int) -> Objects:
        """Return what the labels say of image i, with the model's numbers of classes."""
        assert self.images.labels is not None
        known, names = self.images.labels[i], self.images.classes
        if not self.agent.names or not names:
            return known
        numbers = {name.lower(): number for name, number in self.agent.names.items()}
        for number in known.classes.tolist():
            if names.get(number, "").lower() not in numbers and self._only is None:
                raise UserError(
                    f"Expected labels among the classes of {self.agent_name}, got "
                    f"{names.get(number, number)!r} in {self.images.names[i]}. Name those that "
                    f"count by only=, or pass classes=. It knows {', '.join([*numbers][:20])}."
                )
        mapped = [numbers.get(names.get(number, "").lower(), -1) for number in known.classes]
        return Objects(np.array(mapped, np.int64), known.boxes)

    def truth(self, i: int) -> Objects:
        """Return what counts in the untouched image i."""
        if i not in self._truths:
            known = self._labelled(i) if self.images.labels is not None else self._told(i)
            counts = np.ones(len(known.classes), np.bool_)
            if self._only is not None:
                counts = np.isin(known.classes, [*self._only])
            boxes = known.boxes[counts] if len(known.boxes) else known.boxes
            self._truths[i] = Objects(known.classes[counts], boxes)
        return self._truths[i]

    def _told(self, i: int) -> Objects:
        """Return what the model tells of the untouched image i, as far as it is sure."""
        found = self.agent.found(self.images.image(i))
        if self.task == "classify":
            return Objects(found.classes)
        sure = found.scores >= self._confidence + SURER
        return Objects(found.classes[sure], found.boxes[sure])

    def _clean(self) -> float:
        """Score the model on untouched images; where it says itself what is true, that is 1."""
        numbers = np.random.default_rng(0).permutation(len(self.images))[:_CLEAN_IMAGES].tolist()
        if self.images.labels is None and any(len(self.truth(i).classes) for i in numbers):
            return 1.0
        seen = [self._look(i, [each.nominal for each in self.conditions], 0) for i in numbers]
        if not sum(map(_count_of, seen)):
            raise UserError(
                f"Expected objects that count in the images, got none in {len(seen)} of them. "
                "Check labels=, only= and confidence=."
            )
        return self._score(seen)

    def _look(self, i: int, values: Sequence[Values], seed: int, place: int = 0) -> Seen:
        """Show the model image i under conditions; `place` is its place in the world."""
        image, known = self.images.image(i), self.truth(i)
        under = developed(image, self.conditions, values, (seed, place))
        found = self.agent.found(under.image)
        if self.task == "classify":
            return Seen(i, under, known, place, found, found.classes == known.classes, 0)
        rows, columns = image.shape[:2]
        boxes = moved_boxes(known.boxes, under.target, columns, rows)
        counts = found.scores >= self._confidence
        if self._only is not None:
            counts &= np.isin(found.classes, [*self._only])
        found = Found(
            found.classes[counts], found.scores[counts], found.boxes[counts], found.probabilities
        )
        limits = [columns, rows, columns, rows]
        inside = boxes.clip(0.0, limits)
        seen, right = matched(known.classes, inside, found, self._iou)
        shown = visible(boxes, columns, rows, under.covered)
        truth = Objects(known.classes[shown], inside[shown])
        return Seen(i, under, truth, place, found, seen[shown], int((~right).sum()))

    def _world(self, row: Floats, seed: int) -> list[Seen]:
        """Show the model all images of a world."""
        numbers = np.random.default_rng(seed).choice(len(self.images), self.batch, replace=False)
        values = self._values(row)
        return [self._look(int(i), values, seed, place) for place, i in enumerate(numbers)]

    def _values(self, row: Floats) -> list[Values]:
        given = iter(row.tolist())
        return [tuple(next(given) for _ in each.parameters) for each in self.conditions]

    def _score(self, seen: Sequence[Seen]) -> float:
        if self._score_kind == "confidence":
            return float(
                np.mean([each.found.probabilities[each.truth.classes[0]] for each in seen])
            )
        right, count = (sum(map(f, seen)) for f in (_right_of, _count_of))
        if self._score_kind == "f1":
            return 2.0 * right / max(1, count + right + sum(each.extra for each in seen))
        return right / max(1, count)

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scores, extras = [], []
        for row, seed in zip(self.parameters.physical(mu), seeds, strict=True):
            seen = self._world(row, seed)
            count = sum(map(_count_of, seen))
            scores.append(self._score(seen))
            extras.append(
                {
                    "images": [each.number for each in seen],
                    "right": sum(map(_right_of, seen)),
                    "of": count,
                    "extra": sum(each.extra for each in seen),
                    "wrong": [self._wrong(each) for each in seen if not each.right.all()],
                    "invalid": "" if count else "no object that counts is left in its images",
                }
            )
        return Scored(np.array(scores), extras)

    def _wrong(self, seen: Seen) -> list[str]:
        """Say in a few words for each object of an image what went wrong with it."""
        if self.task == "classify":
            told = self._name(int(seen.found.classes[0]))
            return [f"{self._name(int(seen.truth.classes[0]))} taken for {told}"]
        return [f"{self._name(int(number))} missed" for number in seen.truth.classes[~seen.right]]

    def _name(self, number: int) -> str:
        names = {i: name for name, i in reversed(self.agent.names.items())} or self.images.classes
        return str(names.get(number, f"class {number}"))

    def behaviour(self, info: Mapping[str, Any]) -> Behaviour:
        """Say which images were taken for another class, or which objects were missed."""
        part, done = (
            ("image", "classified correctly") if self.task == "classify" else ("object", "found")
        )
        events = tuple(text for image in info["wrong"] for text in image)
        text = f"all {info['of']} {part}s {done}"
        if events:
            often = [f"{what} ({n})" for what, n in Counter(events).most_common(MOST_NAMED)]
            text = f"{len(events)} of {info['of']} {part}s not {done}: {', '.join(often)}"
        if info["extra"] and self._score_kind == "f1":
            text += f"; {info['extra']} false alarms"
        known = self.images.labels is not None  # else nobody knows what is a false alarm
        return Behaviour(text, events, part, {"false alarms": info["extra"]} if known else {})

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {
            "conditions": [each.settings for each in self.conditions],
            "task": self.task,
            "score": self._score_kind,
            "only": None if self._only is None else sorted(self._only),
            "fooling_threshold": float(self.fooling_threshold),
            "batch": self.batch,
            "confidence": self._confidence,
            "iou": self._iou,
        }

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the model and the images; None where the model or a condition is unknown."""
        agent = identity_of(self.agent, self.agent, self._agent_id)
        if agent is None or (any(c.own for c in self.conditions) and not self._agent_id):
            return None
        return hashlib.sha256(f"{agent}|{self._images_hash}".encode()).hexdigest()

    @cached_property
    def _images_hash(self) -> str:
        return self.images.sha256

    def close(self) -> None:
        """End the process of an agent in a separate process."""
        if isinstance(self.agent, Peer):
            self.agent.close()

    @property
    def legend(self) -> tuple[LegendEntry, ...]:
        """What the marks in frames mean."""
        return LEGENDS[self.task]

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw an untouched image beside the same image in the world, with the model's answers.

        Of the world's images it is the first one in which most went wrong.
        """
        row, seed = validate_world(self.parameters, mu, seed)
        seen = self._worst(row, seed)
        return np.asarray(beside(self._panel(self._untouched(seen)), self._panel(seen)))

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the first image of the world, without annotations."""
        row, seed = validate_world(self.parameters, mu, seed)
        number = np.random.default_rng(seed).choice(len(self.images), self.batch, replace=False)[0]
        values = self._values(self.parameters.physical(row)[0])
        image = self.images.image(int(number))
        return fitted(developed(image, self.conditions, values, (seed, 0)).image)

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Slide the picture of `render` from the untouched image to the world, and score that."""
        row, seed = validate_world(self.parameters, mu, seed)
        seen, usual = self._worst(row, seed), np.asarray(self.nominal)
        before = self._panel(self._untouched(seen))
        frames = []
        for share in np.linspace(0.0, 1.0, _FILM):
            between = (usual + share * (row - usual)).astype(np.float32)
            values = self._values(self.parameters.physical(between)[0])
            now = self._look(seen.number, values, seed, seen.place)
            frames.append(np.asarray(beside(before, self._panel(now))))
        frames += frames[-1:] * int(self.render_fps)
        return frames, float(self.evaluate(row, [seed]).score[0])

    def _worst(self, row: Mu, seed: int) -> Seen:
        seen = self._world(self.parameters.physical(row)[0], seed)
        return max(seen, key=lambda each: int((~each.right).sum()))

    def _untouched(self, seen: Seen) -> Seen:
        return self._look(seen.number, [each.nominal for each in self.conditions], 0)

    def _panel(self, seen: Seen) -> Image.Image:
        found = seen.found
        sure = [f"{p:.2f}" for p in found.scores]
        if self.task == "classify":
            line = f"{self._name(int(found.classes[0]))} ({sure[0]})"
            line += "" if seen.right.all() else f", not {self._name(int(seen.truth.classes[0]))}"
        else:
            line = f"{int(seen.right.sum())} of {len(seen.right)} objects found"
            if seen.extra and self.images.labels is not None:  # else nobody knows
                line += f", {seen.extra} false alarms"
        told = found.boxes
        texts = sure[: len(told)]
        return drawn(seen.developed.image, seen.truth.boxes, seen.right, told, texts, line)


def _right_of(seen: Seen) -> int:
    return int(seen.right.sum())


def _count_of(seen: Seen) -> int:
    return len(seen.right)


def name_of(agent: Any) -> str:
    """Return what reports call an agent: its file's or its class's name."""
    if isinstance(agent, str | Path):
        return Path(agent).name
    return str(getattr(agent, "__name__", type(agent).__name__))
