"""Labelled images: scikit-learn's digits and their split, or a user's own, checked."""

from __future__ import annotations

import functools
import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from sada_gym.errors import UserError, UserTypeError
from sada_gym.foundations.arrays import Floats32, Indices, Integers, as_array

TEST_EVERY = 4
"""Every fourth image of each digit, in the data set's order, is a test image."""

_LARGEST_SIDE = 256


@dataclass(frozen=True, eq=False)
class LabelledImages:
    """Grey images and the class of each."""

    images: Floats32  # (n, height, width) float32 in [0, 1]; 0 is the background
    labels: Integers  # (n,) int64 from 0

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.images)

    def __getitem__(self, rows: Indices) -> LabelledImages:
        """Return the images at these rows."""
        return LabelledImages(self.images[rows], self.labels[rows])

    @property
    def sha256(self) -> str:
        """The hash of the shape, the images as little-endian float32 and the labels as int64."""
        digest = hashlib.sha256(repr(self.images.shape).encode())
        digest.update(np.ascontiguousarray(self.images, dtype="<f4").tobytes())
        digest.update(np.ascontiguousarray(self.labels, dtype="<i8").tobytes())
        return digest.hexdigest()


@functools.cache
def all_digits() -> LabelledImages:
    """Load scikit-learn's digits: 1,797 handwritten ones, 8 x 8, in 17 steps of grey."""
    from sklearn.datasets import load_digits

    data = load_digits()
    images = (np.asarray(data.images) / 16.0).astype(np.float32)
    return _frozen(LabelledImages(images, np.asarray(data.target).astype(np.int64)))


@functools.cache
def turns() -> Integers:
    """Count the digits of the same class before each in the data set, (1797,)."""
    same = all_digits().labels == np.arange(10)[:, None]
    count: Integers = np.where(same, same.cumsum(axis=1) - 1, 0).sum(axis=0)
    return count


@functools.cache
def test_images() -> LabelledImages:
    """Return the digits that no training sees: the 4th, 8th, 12th ... of each class."""
    return _frozen(all_digits()[np.flatnonzero(turns() % TEST_EVERY == TEST_EVERY - 1)])


test_images.__test__ = False  # type: ignore[attr-defined]  # pytest takes it for a test


def validate_images(images: Any, labels: Any) -> LabelledImages:
    """Return a user's images and labels.

    Raises:
        UserError: If there are images without labels or the reverse, they are not (n, height,
            width) floats in [0, 1] with n whole numbers from 0, or an image is too large.
    """
    if images is None or labels is None:
        given, missing = ("images", "labels") if labels is None else ("labels", "images")
        raise UserError(
            f"Expected images= and labels= together, got {given} alone. Pass {missing} as well."
        )
    pictures, classes = as_array(images, "images"), as_array(labels, "labels")
    if pictures.ndim != 3 or 0 in pictures.shape:
        hints = {
            2: " Pass image[None] for a single one.",
            4: " They are grey: leave the channels out.",
        }
        hint = hints.get(pictures.ndim, "")
        raise UserError(f"Expected images of shape (n, height, width), got {pictures.shape}.{hint}")
    if max(pictures.shape[1:]) > _LARGEST_SIDE:
        raise UserError(
            f"Expected images of at most {_LARGEST_SIDE} pixels a side, got {pictures.shape}. "
            "Make them smaller."
        )
    if pictures.dtype.kind != "f":
        raise UserTypeError(
            f"Expected images to be floats in [0, 1], got dtype {pictures.dtype}. Divide them by "
            "their greatest possible value, such as 255."
        )
    wrong = ~((pictures >= 0.0) & (pictures <= 1.0))
    if wrong.any():
        raise UserError(
            f"Expected images within [0, 1], got {pictures[wrong][0]!s} in image "
            f"{int(np.argwhere(wrong)[0, 0])}. Rescale them; 0 is the background."
        )
    if classes.dtype.kind not in "iu" or classes.shape != (len(pictures),) or classes.min() < 0:
        raise UserError(
            f"Expected {len(pictures)} labels, one whole number from 0 for each image, got shape "
            f"{classes.shape} and dtype {classes.dtype}: {classes}."
        )
    copy = np.array(pictures, dtype=np.float32)  # which the user cannot change later
    return _frozen(LabelledImages(copy, classes.astype(np.int64)))


def _frozen(data: LabelledImages) -> LabelledImages:
    data.images.flags.writeable = False
    data.labels.flags.writeable = False
    return data
