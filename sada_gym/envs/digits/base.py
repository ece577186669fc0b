"""What attacks on image classifiers share: the images, the classifier, the pictures."""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from sada_gym import agents
from sada_gym.agents.contract import identity_of
from sada_gym.application import Application, Scored, validate_world
from sada_gym.envs.digits.classifier import ClassifierAgent, ClassifierLike
from sada_gym.envs.digits.images import test_images, validate_images
from sada_gym.envs.hashing import splitmix
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bytes, Floats, Floats32, Indices, Integers
from sada_gym.foundations.behaviour import Behaviour
from sada_gym.foundations.drawing import dashed, font
from sada_gym.foundations.frames import GREEN, VERMILLION, Frame, LegendEntry, rgb
from sada_gym.parameters import Mu

SIDE = 160
"""Pixels a side of an enlarged image, at least."""

RIGHT, WRONG, INK, PAPER = rgb(GREEN), rgb(VERMILLION), (31, 41, 51), (255, 255, 255)
_GAP, _LINE, _CAPTION = 8, 23, 80

LEGEND = (
    LegendEntry("seen as its true class", GREEN, "line"),
    LegendEntry("seen as another class", VERMILLION, "dashed line"),
    LegendEntry(
        "Left: the image, with its true class. Right: what the adversary made of it. p is the "
        "classifier's probability of the true class."
    ),
)


def enlarged(image: Floats32) -> Bytes:
    """Draw an image (height, width) in [0, 1] with large square pixels: (h, w, 3) uint8."""
    factor = max(1, -(-SIDE // max(image.shape)))
    grey = np.rint(255.0 * image.astype(np.float64)).astype(np.uint8)
    large = grey.repeat(factor, axis=0).repeat(factor, axis=1)
    return np.repeat(large[..., None], 3, axis=2)


def beside(images: Floats32, probabilities: Floats, label: int) -> Bytes:
    """Draw an unchanged image and the changed one side by side, with captions.

    Images are (2, height, width) in [0, 1], with probabilities (2, K); `label` is the true class.
    """
    panels = [enlarged(image) for image in images]
    height, width = panels[0].shape[:2]
    width = max(width, SIDE)  # room for the caption
    picture = Image.new("RGB", (2 * width + 3 * _GAP, height + _CAPTION + _GAP), PAPER)
    draw, face = ImageDraw.Draw(picture), font(20)
    titles = (f"true: {with_article(label)}", "attacked")
    for i, (title, panel) in enumerate(zip(titles, panels, strict=True)):
        left = _GAP + i * (width + _GAP)
        guess = int(probabilities[i].argmax())
        right = guess == label
        lines = (
            title,
            f"seen as {with_article(guess)}",
            f"p({label}) = {probabilities[i, label]:.2f}",
        )
        for k, line in enumerate(lines):
            draw.text((left, 2 + k * _LINE), line, fill=INK, font=face)
        ends = [(left, _CAPTION - 3), (left + panel.shape[1], _CAPTION - 3)]
        dashed(draw, ends, RIGHT if right else WRONG, 5, 14, 0 if right else 8)
        picture.paste(Image.fromarray(panel), (left, _CAPTION))
    return np.asarray(picture)


_PIXELS_AT_ONCE = 2**18


class ClassifierApplication(Application):
    """A frozen classifier looks at changed images.

    A subclass sets `parameters`, says how mu changes images and how the classifier's probabilities
    are scored, and describes the arguments.

    Raises:
        UserError: If the agent, the images or the labels are not as described, there is no such
            image or digit, or the classifier gets no image of it right.
    """

    def __init__(
        self,
        image: int | None,
        digit: int | None,
        agent: str | Path | ClassifierLike,
        agent_id: str | None,
        images: npt.ArrayLike | None,
        labels: npt.ArrayLike | None,
        tile: int | None,
    ) -> None:
        self.agent_name, self.agent = agents.resolve(agent, self.name, agent_id)
        self._agent_id = agent_id
        self._classifier = ClassifierAgent(self.agent, tile)
        self._own_images = images is not None or labels is not None
        self.images = validate_images(images, labels) if self._own_images else test_images()
        self.image = None if image is None else self._validate_image(image)
        self.digit = None if digit is None else self._validate_digit(digit)
        self.indices = self._attackable()

    @property
    def tile(self) -> int:
        """Images in one call of the classifier."""
        return self._classifier.tile

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        digit = self.digit if self.image is None else None
        return {"image": self.image, "digit": digit, "tile": self.tile}

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the classifier's identity and, where a user brought them, the images.

        None where the classifier has no identity.
        """
        agent = identity_of(self._classifier, self.agent, self._agent_id)
        if agent is None:
            return None
        parts = [agent, self.images.sha256 if self._own_images else ""]
        return hashlib.sha256("|".join(parts).encode()).hexdigest()

    def _validate_image(self, image: Any) -> int:
        if not _is_whole(image) or not 0 <= image < len(self.images):
            raise UserError(
                f"Expected image to be an index from 0 to {len(self.images) - 1}, got {image!r}."
            )
        return int(image)

    def _validate_digit(self, digit: Any) -> int:
        known = np.unique(self.images.labels).tolist()
        if not _is_whole(digit) or digit not in known:
            raise UserError(
                f"Expected digit to be a class among {', '.join(map(str, known))}, got {digit!r}."
            )
        if self.image is not None and self.images.labels[self.image] != digit:
            label = int(self.images.labels[self.image])
            raise UserError(
                f"Expected an image of digit {digit}, got image {self.image}, whose label is "
                f"{label}. Leave digit= or image= out."
            )
        return int(digit)

    def _attackable(self) -> Indices:
        labels = self.images.labels
        rows = np.arange(len(labels))
        if self.image is not None:
            rows = rows[[self.image]]
        elif self.digit is not None:
            rows = rows[labels == self.digit]
        self._classifier.check_logits(self.images.images[rows])
        answers = self._classifier.act(self.images.images[rows])
        if labels.max() >= answers.shape[1]:
            raise UserError(
                f"Expected labels below {answers.shape[1]}, the number of the classifier's "
                f"classes, got {labels.max()}. Pass the labels that it was trained with, from 0."
            )
        if self.image is not None:
            return rows
        right: Indices = rows[answers.argmax(axis=1) == labels[rows]]
        if not len(right):
            raise UserError(
                f"Expected a classifier that gets some of the {len(rows)} unchanged images right, "
                f"got {self.agent_name}, which gets none: there is nothing to attack. Check that "
                "labels= counts classes as the classifier does."
            )
        return right

    @abstractmethod
    def _change(self, mu: Mu, positions: Indices) -> Floats32:
        """Change images: mu (n, d), positions (n,) within `indices`, to (n, height, width)."""

    @abstractmethod
    def _score(self, probabilities: Floats, labels: Integers) -> Floats:
        """Score probabilities (n, K) by the true classes (n,): Q, (n,)."""

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        positions = self._positions(seeds)
        rows = self.indices[positions]
        labels, probabilities = self.images.labels[rows], self._classified(mu, positions)
        columns = {"image": rows, "label": labels, "predicted": probabilities.argmax(axis=1)}
        answers = zip(*(column.tolist() for column in columns.values()), strict=True)
        extras = [dict(zip(columns, answer, strict=True)) for answer in answers]
        return Scored(self._score(probabilities, labels), extras)

    def _positions(self, seeds: Sequence[int]) -> Indices:
        # `seed % n` alone would show each stream its own images: its seeds share their lowest bits
        mixed = splitmix(np.array(seeds, np.uint64))
        return (mixed % np.uint64(len(self.indices))).astype(np.intp)

    def _classified(self, mu: Mu, positions: Indices) -> Floats:
        """Return the classifier's probabilities for the changed images, (n, K)."""
        step = max(1, _PIXELS_AT_ONCE // self.images.images[0].size)
        parts = [slice(start, start + step) for start in range(0, len(mu), step)]
        return np.concatenate(
            [self._classifier.act(self._change(mu[part], positions[part])) for part in parts]
        )

    def behaviour(self, info: Mapping[str, Any]) -> Behaviour:
        """Say which class the image was taken for."""
        return behaviour(info)

    def attacked_image(self, mu: npt.ArrayLike, seed: int) -> tuple[Floats32, Floats32]:
        """Return the unchanged image of a seed and the one that mu, (d,), makes of it."""
        row, seed = validate_world(self.parameters, mu, seed)
        positions = self._positions([seed])
        return self.images.images[self.indices[positions[0]]], self._change(row, positions)[0]

    @property
    def legend(self) -> tuple[LegendEntry, ...]:
        """What the marks in frames mean."""
        return LEGEND

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the unchanged image beside the changed one, with the classifier's answers."""
        row, seed = validate_world(self.parameters, mu, seed)
        (index,) = self.indices[self._positions([seed])]
        pictures = np.stack(self.attacked_image(row[0], seed))
        probabilities = self._classifier.act(pictures)
        return beside(pictures, probabilities, int(self.images.labels[index]))

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the changed image, which the classifier sees, enlarged."""
        return enlarged(self.attacked_image(mu, seed)[1])


def _is_whole(given: Any) -> bool:
    return isinstance(given, int | np.integer) and not isinstance(given, bool)


def behaviour(info: Mapping[str, Any]) -> Behaviour:
    """Say what a classifier took an image for, by the info of an evaluation."""
    label, predicted = info["label"], info["predicted"]
    data = {"label": label, "predicted": predicted}
    if label != predicted:
        event = f"taken for {with_article(predicted)}"
        return Behaviour(f"{with_article(label)}, {event}", (event,), data=data)
    if info["fooled"]:
        return Behaviour(f"{with_article(label)}, with little confidence", ("unsure",), data=data)
    return Behaviour(f"{with_article(label)}, recognised", data=data)


def with_article(number: int) -> str:
    """Name a class with its article: `an 8`."""
    return f"an {number}" if str(number).startswith("8") or number in (11, 18) else f"a {number}"
