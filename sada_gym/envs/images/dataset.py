"""A data set: images of any kind, and what is known to be in them.

Images are read one at a time, when they are needed, so that ten thousand take no more memory than a
few. Labels are read as the tools of their formats read them.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import warnings
from collections import Counter, OrderedDict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageOps

from sada_gym.agents.contract import Task
from sada_gym.errors import FileError, Notice, UserError, UserTypeError, described
from sada_gym.foundations.arrays import Bytes, Floats
from sada_gym.foundations.files import as_path, read_file

ENDINGS = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff", ".ppm", ".pgm")
"""The endings of the files that count as images in a folder."""

MAX_PIXELS = 2**26
"""Larger images are refused: under conditions one takes a gigabyte."""
_KEPT_BYTES = 2**28
_LABEL_BYTES = 2**30
_SHOWN = 3


@dataclass(frozen=True)
class Objects:
    """What is in an image.

    Attributes:
        classes: (k,) int64: the class of each object; of a classified image the one class.
        boxes: (k, 4) x0 y0 x1 y1 in px; none where the image as a whole has a class.
    """

    classes: npt.NDArray[np.int64]
    boxes: Floats = field(default_factory=lambda: np.zeros((0, 4)))


@dataclass
class ImageSet:
    """Images and their labels.

    Attributes:
        sources: Files or arrays.
        names: What messages and pictures call them.
        labels: What is in each; None where nobody knows.
        task: What the labels are for; None without labels.
        classes: The names of the classes by number, as far as they are known.
    """

    sources: list[Path | Bytes]
    names: list[str]
    labels: list[Objects] | None = None
    task: Task | None = None
    classes: dict[int, str] = field(default_factory=dict)
    _kept: OrderedDict[int, Bytes] = field(default_factory=OrderedDict, repr=False)

    def __len__(self) -> int:
        """Count the images."""
        return len(self.sources)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the images that are held in memory for a while."""
        return {**self.__dict__, "_kept": OrderedDict()}

    def image(self, i: int) -> Bytes:
        """Return image i, (height, width, 3) uint8. The last ones stay in memory.

        Raises:
            FileError: If its file cannot be read.
        """
        source = self.sources[i]
        if not isinstance(source, Path):
            return source
        if i in self._kept:
            self._kept.move_to_end(i)
            return self._kept[i]
        self._kept[i] = image = read_image(source)
        held = sum(kept.nbytes for kept in self._kept.values())
        while held > _KEPT_BYTES and len(self._kept) > 1:
            held -= self._kept.popitem(last=False)[1].nbytes
        return image

    @property
    def sha256(self) -> str:
        """SHA-256 over the images' files or pixels, and their labels."""
        digest = hashlib.sha256()
        for source in self.sources:
            if isinstance(source, Path):
                digest.update(hashlib.sha256(read_file(source, _LABEL_BYTES)).digest())
            else:
                digest.update(str(source.shape).encode() + source.tobytes())
        for known in self.labels or ():
            digest.update(known.classes.tobytes() + known.boxes.tobytes())
        digest.update(json.dumps(self.classes, sort_keys=True).encode())
        return digest.hexdigest()


def read_image(path: Path) -> Bytes:
    """Read an image as (height, width, 3) uint8, turned as its EXIF data say.

    Grey images get three equal channels, 16 bits become 8, and what is transparent lies on white.

    Raises:
        FileError: If it is no image, is damaged, or has more than `MAX_PIXELS`.
    """
    with _opened(path) as opened:
        picture: Any = ImageOps.exif_transpose(opened)
        if picture.mode.startswith("I"):
            grey = np.asarray(picture, np.int64)
            top = 257 if picture.mode.startswith("I;16") or grey.max(initial=0) > 255 else 1
            picture = Image.fromarray((grey // top).clip(0, 255).astype(np.uint8))
        if picture.mode in ("RGBA", "LA", "PA") or "transparency" in picture.info:
            own = picture.convert("RGBA")
            white = Image.new("RGBA", own.size, "white")
            picture = Image.alpha_composite(white, own)
        return np.array(picture.convert("RGB"))


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open an image, whose header is checked; what fails in the block is told as the file's."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path) as opened:
                if math.prod(opened.size) > MAX_PIXELS or min(opened.size) < 2:
                    raise _wrong_size(path, "{} x {}".format(*opened.size))
                yield opened
    except FileError:
        raise
    except Image.DecompressionBombError as error:
        raise _wrong_size(path, "far more") from error
    except Exception as error:  # Pillow's readers raise whatever a damaged file leads to
        raise FileError(
            f"Expected an image in {path}, got: {described(error)}. Remove the file, or pass "
            "skip_unreadable=True."
        ) from error


def _wrong_size(path: Path, got: str) -> FileError:
    return FileError(
        f"Expected an image of 2 px a side to {MAX_PIXELS:,} px in all in {path}, got {got}. Scale "
        "it down, or pass skip_unreadable=True."
    )


def image_set(
    images: Any,
    labels: Any = None,
    *,
    classes: Sequence[str] | None = None,
    skip_unreadable: bool = False,
) -> ImageSet:
    """Return the images and labels that a user names.

    Args:
        images: A folder, a list of files, or arrays (height, width, 3) uint8.
        labels: COCO's JSON file, a folder of YOLO's text files, a class for each image, or a
            dictionary of `boxes` (k, 4) and `labels` (k,) for each, as torchvision has them. None
            takes the names of a folder's own folders as classes, if all images lie in some; False
            says that there are none.
        classes: The names of the labels' classes, from 0.
        skip_unreadable: Leave out images that cannot be read, and say how many, instead of raising.

    Raises:
        UserError: If there is no image, one of them cannot be read, or labels do not fit.
    """
    if isinstance(images, str | Path):
        found = _folder(as_path(images, "a folder of images"), with_classes=labels is None)
    else:
        found = _listed(images)
    if not found.sources:
        raise UserError(
            f"Expected at least one image ({', '.join(ENDINGS)}), got none in {str(images)!r}. "
            "Name the folder that holds them."
        )
    unreadable = _unreadable(found, decode=skip_unreadable)
    if unreadable and not skip_unreadable:
        raise next(iter(unreadable.values()))
    in_files = isinstance(labels, str | Path)
    if not in_files and labels is not None and labels is not False:
        _given(found, labels)
    if unreadable:
        _leave_out(found, unreadable)
    if in_files:
        path = as_path(labels, "a file or folder of labels")
        reader = _coco if path.suffix.lower() == ".json" else _yolo
        reader(found, path)
    if classes is not None:
        found.classes = {i: str(name) for i, name in enumerate(classes)}
    return found


def _folder(folder: Path, *, with_classes: bool) -> ImageSet:
    if not folder.is_dir():
        raise FileError(f"Expected a folder of images, got {folder}. Check its path.")
    every = (
        Path(place, name)
        for place, _, names in os.walk(folder, followlinks=True)
        for name in names
        if Path(name).suffix.lower() in ENDINGS
    )
    files = sorted(path for path in every if path.is_file())
    names = [str(path.relative_to(folder)) for path in files]
    found = ImageSet([*files], names)
    tops = [path.relative_to(folder).parts[0] for path in files]
    if (
        with_classes
        and files
        and all(folder / top != path for top, path in zip(tops, files, strict=True))
    ):
        if all(top.isdecimal() for top in tops):  # the classes' own numbers
            numbers = {top: int(top) for top in tops}
        else:  # torchvision's ImageFolder: a number for each folder, empty ones too, by their names
            folders = sorted(path.name for path in folder.iterdir() if path.is_dir())
            numbers = {top: i for i, top in enumerate(folders)}
            found.classes = {i: top for top, i in numbers.items()}
        found.labels = [Objects(np.array([numbers[top]])) for top in tops]
        found.task = "classify"
    return found


def _listed(images: Any) -> ImageSet:
    if isinstance(images, np.ndarray) and images.ndim == 4:
        images = [*images]
    if not isinstance(images, Sequence):
        raise UserTypeError(
            "Expected images as a folder, a list of files, or arrays (height, width, 3) uint8, "
            f"got {type(images).__name__}."
        )
    sources: list[Path | Bytes] = []
    for i, each in enumerate(images):
        if isinstance(each, str | Path):
            sources.append(as_path(each, "an image"))
            continue
        array = np.asarray(each)
        if (
            array.dtype != np.uint8
            or array.ndim != 3
            or array.shape[2] != 3
            or min(array.shape) < 2
        ):
            raise UserError(
                f"Expected image {i} as an array (height, width, 3) uint8, got {array.dtype} "
                f"{array.shape}."
            )
        sources.append(np.ascontiguousarray(array))
    names = [str(s) if isinstance(s, Path) else f"image {i}" for i, s in enumerate(sources)]
    return ImageSet(sources, names)


def _unreadable(found: ImageSet, *, decode: bool) -> dict[int, FileError]:
    """Return the errors of images that cannot be read; without decoding only of their headers."""
    errors = {}
    for i, source in enumerate(found.sources):
        if not isinstance(source, Path):
            continue
        try:
            if decode:
                read_image(source)
            else:
                with _opened(source):
                    pass
        except FileError as error:
            errors[i] = error
    return errors


def _leave_out(found: ImageSet, unreadable: Mapping[int, FileError]) -> None:
    kept = [i for i in range(len(found)) if i not in unreadable]
    if not kept:
        raise next(iter(unreadable.values()))
    left_out = [found.names[i] for i in unreadable]
    _tell(f"{len(left_out)} of {len(found)} images cannot be read and are left out", left_out)
    _keep(found, kept)


def _tell(what: str, names: Sequence[str]) -> None:
    more = len(names) - _SHOWN
    rest = f" and {more} more" if more > 0 else ""
    warnings.warn(f"{what}: {', '.join(names[:_SHOWN])}{rest}.", Notice, stacklevel=4)


def _keep(found: ImageSet, chosen: Sequence[int]) -> None:
    found.sources = [found.sources[i] for i in chosen]
    found.names = [found.names[i] for i in chosen]
    if found.labels is not None:
        found.labels = [found.labels[i] for i in chosen]


def _given(found: ImageSet, labels: Any) -> None:
    if not isinstance(labels, Sequence | np.ndarray) or len(labels) != len(found):
        raise UserError(
            f"Expected a label for each of {len(found)} images, got "
            f"{len(labels) if isinstance(labels, Sequence | np.ndarray) else repr(labels)}."
        )
    if all(isinstance(label, Mapping) for label in labels):
        found.task = "detect"
        found.labels = [
            _boxed(label.get("boxes", ()), label.get("labels", ()), found.names[i])
            for i, label in enumerate(labels)
        ]
        return
    numbers = np.asarray(labels)
    if numbers.shape != (len(found),) or numbers.dtype.kind not in "iu" or numbers.min() < 0:
        raise UserError(
            "Expected the class of each image as a whole number from 0, or a dictionary of boxes "
            f"and labels, got {labels[0]!r}."
        )
    found.task = "classify"
    found.labels = [Objects(np.array([number], np.int64)) for number in numbers]


def _boxed(boxes: Any, classes: Any, where: str) -> Objects:
    corners = np.asarray(boxes, np.float64).reshape(-1, 4)
    numbers = np.asarray(classes)
    if numbers.shape != (len(corners),) or (len(numbers) and numbers.dtype.kind not in "iu"):
        raise UserError(
            f"Expected boxes (k, 4) and as many whole labels for {where}, got {len(corners)} boxes "
            f"and labels {numbers.dtype} {numbers.shape}."
        )
    return Objects(numbers.astype(np.int64), corners)


def _size_of(source: Path | Bytes) -> tuple[int, int]:
    """Return an image's width and height as it is read, without decoding it."""
    if not isinstance(source, Path):
        return source.shape[1], source.shape[0]
    with Image.open(source) as opened:
        turned = opened.getexif().get(0x0112, 1) >= 5  # the orientation that swaps both sides
        width, height = opened.size
    return (height, width) if turned else (width, height)


def check_inside(found: ImageSet, file: Callable[[int], str]) -> None:
    """Raise `UserError` for a box that is empty or does not lie in its image; `file` names it."""
    for i, known in enumerate(found.labels or ()):
        if not len(known.boxes):
            continue
        width, height = _size_of(found.sources[i])
        x0, y0, x1, y1 = known.boxes.T
        inside = (x1 > x0) & (y1 > y0) & (x1 > 0) & (y1 > 0) & (x0 < width) & (y0 < height)
        # a pixel beyond is rounding
        inside &= (x0 >= -1) & (y0 >= -1) & (x1 <= width + 1) & (y1 <= height + 1)
        if not inside.all():
            box = known.boxes[int(inside.argmin())].round(1).tolist()
            raise UserError(
                f"Expected boxes inside of {found.names[i]}, which is {width} x {height} px, got "
                f"{box} in {file(i)}. Fix the label."
            )


def _coco(found: ImageSet, path: Path) -> None:
    """Read COCO's instances; groups (`iscrowd`) do not count."""
    try:
        table = json.loads(read_file(path, _LABEL_BYTES))
        files = {row["id"]: row["file_name"] for row in table["images"]}
        found.classes = {int(row["id"]): str(row["name"]) for row in table["categories"]}
        rows: dict[str, list[tuple[int, list[float]]]] = {name: [] for name in files.values()}
        for row in table["annotations"]:
            if not row.get("iscrowd"):
                x, y, width, height = map(float, row["bbox"])
                box = [x, y, x + width, y + height]
                rows[files[row["image_id"]]].append((int(row["category_id"]), box))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileError(
            f"Expected COCO's instances in {path}, with images, annotations and categories, got: "
            f"{described(error)}."
        ) from error
    partners = _partners(found.names, rows, path)
    chosen = [i for i, partner in enumerate(partners) if partner is not None]
    if not chosen:
        raise UserError(
            f"Expected the files of {path}, such as {next(iter(rows), 'none')!r}, among the "
            f"images, got {found.names[0]!r} and so on."
        )
    _keep(found, chosen)
    found.task = "detect"
    labelled = [rows[partner] for partner in partners if partner is not None]
    found.labels = [
        _boxed([box for _, box in row], [number for number, _ in row] or np.zeros(0, int), name)
        for row, name in zip(labelled, found.names, strict=True)
    ]
    check_inside(found, lambda _: str(path))


def _partners(names: Sequence[str], known: Collection[str], where: Path) -> list[str | None]:
    """Return which known name is that of each image: the same path, or else the same last part.

    Raises:
        UserError: If only the last part is the same, and several have it.
    """
    alike: dict[str, list[str]] = {}
    for other in known:
        alike.setdefault(Path(other).name, []).append(other)
    counts = Counter(Path(name).name for name in names)

    def partner(name: str) -> str | None:
        others = [name] if name in known else alike.get(Path(name).name, [])
        if name not in known and len(others) * counts[Path(name).name] > 1:
            raise UserError(
                f"Expected labels of one image named {Path(name).name} in {where}, got those of "
                f"{', '.join(others[:3])} for {counts[Path(name).name]} such images. Name the "
                "folder below which the images lie as the labels have them."
            )
        return others[0] if others else None

    partners = [partner(Path(name).as_posix()) for name in names]
    others = [*{*known} - {*partners} - {"classes"}]
    if others and len(others) < len(known):
        _tell(f"{len(others)} of {len(known)} labels in {where} have no image", sorted(others))
    return partners


def _yolo(found: ImageSet, folder: Path) -> None:
    """Read YOLO's text files: `class x y width height`, as shares of the image, or a polygon."""
    if not folder.is_dir():
        raise FileError(
            f"Expected labels as COCO's .json file or a folder of YOLO's .txt files, got {folder}."
        )
    files = {
        path.relative_to(folder).with_suffix("").as_posix(): path
        for path in sorted(folder.rglob("*.txt"))
    }
    stems = [str(Path(name).with_suffix("")) for name in found.names]
    partners = _partners(stems, files, folder)
    own = [None if partner is None else files[partner] for partner in partners]
    if not any(own):
        raise UserError(
            f"Expected a text file for an image in {folder}, such as {Path(stems[0]).name}.txt, "
            "got none."
        )
    found.task, found.labels = "detect", []
    for source, file, name in zip(found.sources, own, found.names, strict=True):
        size = np.array(_size_of(source), np.float64)
        text = "" if file is None else read_file(file, _LABEL_BYTES).decode()
        rows = [*_yolo_rows(text, file or folder)]
        boxes = [np.concatenate([low * size, high * size]) for _, low, high in rows]
        numbers = np.array([number for number, _, _ in rows], np.int64)
        found.labels.append(_boxed(boxes, numbers, name))
    check_inside(found, lambda i: str(own[i]))


def _yolo_rows(text: str, path: Path) -> Iterator[tuple[int, Floats, Floats]]:
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        try:
            first, *rest = line.split()
            values = np.array([float(part) for part in rest])
            if len(values) == 4:
                low, high = values[:2] - values[2:] / 2, values[:2] + values[2:] / 2
            elif len(values) >= 6 and len(values) % 2 == 0:
                low, high = values.reshape(-1, 2).min(axis=0), values.reshape(-1, 2).max(axis=0)
            else:
                raise ValueError(f"{len(values)} numbers")
            yield int(first), low, high
        except ValueError as error:
            raise FileError(
                f"Expected `class x y width height` in line {number} of {path}, got {line[:60]!r} "
                f"({described(error)})."
            ) from error
