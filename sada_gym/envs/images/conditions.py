"""The conditions under which a model sees images, and how images are made under all of them.

A condition has one or more parameters with a unit, a range, and values at which it does nothing.
They act in one order: first the scene, then the weather, the lens, the sensor and what becomes of
its picture. Those that only change colours are tables; neighbouring tables become one.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sada_gym.envs.images import geometry, optics
from sada_gym.envs.images.geometry import Move
from sada_gym.envs.images.optics import Values
from sada_gym.errors import MissingExtra, UserError, UserTypeError, check_known, install_line
from sada_gym.foundations.arrays import Bytes
from sada_gym.parameters import Parameter


@dataclass(frozen=True)
class Condition:
    """One effect of the scene, the weather or the camera on images.

    Give exactly one of `table`, `change` and `moves`. They are functions of the parameters' values.

    Attributes:
        name: The condition's name.
        parameters: The parameters that the adversary sets.
        nominal: Their values in ordinary images. With the first one the condition does nothing.
        source: The source of its model and its ranges.
        table: `table(*values)` returns the new value of each value of a channel, (256, 3) uint8.
        change: `change(image, values, rng)` returns a changed image, (height, width, 3) uint8. All
            random numbers must come from `rng`.
        moves: `moves(*values)` returns two functions of points: where they go, and where they come
            from, see `sada_gym.envs.images.geometry`. Objects move with the image.
        covers: `covers(*values, width, height)`, only beside `change`, returns a box x0 y0 x1 y1 in
            px that hides what is behind it.
    """

    name: str
    parameters: tuple[Parameter, ...]
    nominal: Values
    source: str = ""
    table: Callable[..., optics.Table] | None = None
    change: Callable[[Bytes, Values, np.random.Generator], Bytes] | None = None
    moves: Callable[..., tuple[Move, Move]] | None = None
    covers: Callable[..., tuple[int, ...]] | None = None
    own: bool = True

    def __post_init__(self) -> None:
        """Check that it has parameters, a nominal value of each, and one way to act."""
        ways = [way for way in (self.table, self.change, self.moves) if way is not None]
        if len(ways) != 1 or not self.parameters or len(self.parameters) != len(self.nominal):
            raise UserError(
                f"Expected parameters, a nominal value of each, and one of table, change and moves "
                f"in the condition {self.name!r}, got {len(self.parameters)}, {len(self.nominal)} "
                f"and {len(ways)} of them."
            )
        for parameter, value in zip(self.parameters, self.nominal, strict=True):
            if not parameter.low <= value <= parameter.high:
                raise UserError(
                    f"Expected the nominal value of {parameter.name!r} within {parameter.low:g} to "
                    f"{parameter.high:g}, got {value:g}."
                )

    @property
    def settings(self) -> dict[str, Any]:
        """What a score depends on, JSON-compatible."""
        ranges = {each.name: [each.low, each.high] for each in self.parameters}
        return {"name": self.name, "ranges": ranges}

    def is_off(self, values: Values) -> bool:
        """Say whether the condition does nothing."""
        return values[0] == self.nominal[0]


def _condition(name: str, *parameters: Parameter, nominal: Values, **ways: Any) -> Condition:
    return Condition(name, parameters, nominal, own=False, **ways)


CONDITIONS: Mapping[str, Condition] = {
    each.name: each
    for each in (
        _condition(
            "shadow",
            Parameter("shadow_ev", 0.0, 4.0, "EV"),
            Parameter("shadow_place", -1.0, 1.0),
            nominal=(0.0, 0.0),
            source="open shade lies 2 to 4 EV below the sun (photographers' sunny 16 rule)",
            change=optics.shaded,
        ),
        _condition(
            "rain",
            Parameter("rain_mm_h", 0.0, 50.0, "mm/h"),
            nominal=(0.0,),
            source="heavy rain is above 7.6 mm/h, violent rain above 50 (AMS, UK Met Office)",
            change=optics.rained,
        ),
        _condition(
            "snow",
            Parameter("snow_mm_h", 0.0, 5.0, "mm/h"),
            nominal=(0.0,),
            source="heavy snow is above 2.5 mm/h of water (Rasmussen et al. 1999)",
            change=optics.snowed,
        ),
        _condition(
            "low_sun",
            Parameter("low_sun", 0.0, 1.0),
            Parameter("low_sun_place", -1.0, 1.0),
            nominal=(0.0, 0.0),
            source="veiling glare of up to a quarter of white (ISO 9358 says how to measure it)",
            change=optics.sunlit,
        ),
        _condition(
            "rotation",
            Parameter("rotation_deg", -20.0, 20.0, "deg"),
            nominal=(0.0,),
            source="hand-held pictures are seldom rotated by more",
            moves=geometry.turning,
        ),
        _condition(
            "zoom",
            Parameter("zoom", 0.4, 2.0, log=True),
            nominal=(1.0,),
            source="as from two and a half times the distance to half of it",
            moves=geometry.zooming,
        ),
        _condition(
            "distortion",
            Parameter("distortion", -0.15, 0.15),
            nominal=(0.0,),
            source="Brown's k1 of wide-angle lenses: a barrel above 0, a pincushion below",
            moves=geometry.distorting,
        ),
        _condition(
            "occluder",
            Parameter("occluder_size", 0.0, 0.4),
            Parameter("occluder_x", -1.0, 1.0),
            Parameter("occluder_y", -1.0, 1.0),
            nominal=(0.0, 0.0, 0.0),
            source="a square up to 0.4 of the longer side, as in Cutout (arXiv 1708.04552)",
            change=optics.occluded,
            covers=optics.occluder,
        ),
        _condition(
            "dirt",
            Parameter("dirt", 0.0, 0.4),
            nominal=(0.0,),
            source="share of the lens that is dirty, as in WoodScape (arXiv 1905.01489)",
            change=optics.dirtied,
        ),
        _condition(
            "defocus",
            Parameter("defocus", 0.0, 0.01),
            nominal=(0.0,),
            source="radius of the blur circle as a share of the longer side: 6 px of 640; "
            "ImageNet-C's severest is 10 of 224",
            change=optics.defocused,
        ),
        _condition(
            "motion_blur",
            Parameter("motion_blur", 0.0, 0.03),
            Parameter("motion_deg", 0.0, 180.0, "deg"),
            nominal=(0.0, 0.0),
            source="length of the blur as a share of the longer side: 19 px of 640; ImageNet-C's "
            "severest is 20 of 224",
            change=optics.moved,
        ),
        _condition(
            "fog",
            Parameter("visibility_m", 30.0, 10_000.0, "m", log=True),
            nominal=(10_000.0,),
            source="Koschmieder's law; fog is below 1 km, dense fog below 50 m (WMO)",
            table=optics.fogged,
        ),
        _condition(
            "exposure",
            Parameter("exposure_ev", -3.0, 3.0, "EV"),
            nominal=(0.0,),
            source="the compensation that cameras offer",
            table=optics.exposed,
        ),
        _condition(
            "temperature",
            Parameter("temperature_k", 2_500.0, 15_000.0, "K", log=True),
            nominal=(6_500.0,),
            source="from light bulbs to blue shade, with the white balance of daylight",
            table=optics.lit,
        ),
        _condition(
            "noise",
            Parameter("iso", 100.0, 25_600.0, log=True),
            nominal=(100.0,),
            source="EMVA 1288's linear model, full well 10,000 electrons, read noise 3",
            change=optics.noisy,
        ),
        _condition(
            "dead_rows",
            Parameter("dead_rows", 0.0, 0.2),
            nominal=(0.0,),
            source="share of rows, from none to a broken sensor",
            change=optics.dead_rows,
        ),
        _condition(
            "contrast",
            Parameter("contrast", 0.3, 1.7),
            nominal=(1.0,),
            source="a little beyond ImageNet-C's mildest, 0.4 (its severest is 0.05)",
            table=optics.contrasted,
        ),
        _condition(
            "resolution",
            Parameter("resolution", 0.15, 1.0, log=True),
            nominal=(1.0,),
            source="share of the pixels of each side; ImageNet-C's severest is 0.25 of 224",
            change=optics.coarser,
        ),
        _condition(
            "jpeg",
            Parameter("jpeg_quality", 5.0, 95.0),
            nominal=(95.0,),
            source="libjpeg's scale; ImageNet-C's severest is 7",
            change=optics.compressed,
        ),
    )
}
"""All conditions by name, in the order in which they act."""

SETS: Mapping[str, tuple[str, ...]] = {
    "common": ("rotation", "zoom", "defocus", "fog", "exposure", "noise", "jpeg"),
    "camera": (
        *("rotation", "zoom", "distortion", "dirt", "defocus", "motion_blur", "exposure"),
        *("temperature", "noise", "dead_rows", "contrast", "resolution", "jpeg"),
    ),
    "weather": ("shadow", "rain", "snow", "low_sun", "fog"),
    "all": tuple(CONDITIONS),
}
"""The sets of conditions that have a name."""


def find_conditions(
    given: str | Sequence[str | Condition] | Mapping[str, Any],
) -> tuple[Condition, ...]:
    """Return conditions in the order in which they act; a user's own act last.

    Args:
        given: The name of a set; names and conditions; or a dictionary from a name to True, or to
            another range (low, high) of its first parameter.

    Raises:
        UserError: If a name is unknown, a condition or a parameter is there twice, or a range does
            not hold the nominal value.
    """
    if isinstance(given, str):
        check_known("set of conditions", [given], [*SETS])
        given = SETS[given]
    if not isinstance(given, Sequence | Mapping) or not given:
        raise UserTypeError(f"Expected conditions as a name, a list or a table, got {given!r}.")
    names = [each for each in given if isinstance(each, str)]
    check_known("condition", names, [*CONDITIONS])
    if isinstance(given, Mapping):
        chosen = [_narrowed(CONDITIONS[name], value) for name, value in given.items()]
    else:
        chosen = [CONDITIONS[each] if isinstance(each, str) else each for each in given]
    if odd := [each for each in chosen if not isinstance(each, Condition)]:
        raise UserTypeError(f"Expected a condition's name or a Condition, got {odd[0]!r}.")
    parameters = [parameter.name for each in chosen for parameter in each.parameters]
    if twice := [name for name in parameters if parameters.count(name) > 1]:
        raise UserError(f"Expected each parameter once, got {twice[0]!r} twice.")
    order = [*CONDITIONS]
    return tuple(
        sorted(chosen, key=lambda each: len(order) if each.own else order.index(each.name))
    )


def _narrowed(condition: Condition, given: Any) -> Condition:
    """Return a condition with another range of its first parameter; True leaves it as it is."""
    if given is True:
        return condition
    if not isinstance(given, Sequence) or len(given) != 2 or isinstance(given, str):
        raise UserTypeError(
            f"Expected true or [low, high] for the condition {condition.name!r}, got {given!r}."
        )
    first, *others = condition.parameters
    low, high = given
    return replace(condition, parameters=(replace(first, low=low, high=high), *others))


@dataclass(frozen=True)
class Developed:
    """An image as it is seen under conditions.

    Attributes:
        image: (height, width, 3) uint8.
        target: Says where its points went.
        covered: Boxes x0 y0 x1 y1 in px that hide what is behind them.
    """

    image: Bytes
    target: Move
    covered: tuple[tuple[int, ...], ...]


def developed(
    image: Bytes, conditions: Sequence[Condition], values: Sequence[Values], seed: Sequence[int]
) -> Developed:
    """Make an image under conditions, with their values, in one thread.

    Each condition has a generator of its own, so that it does the same whichever others there are.
    """
    import cv2

    rows, columns = image.shape[:2]
    table: optics.Table | None = None
    moves: list[tuple[Move, Move]] = []
    waiting = 0  # moves that the image has still to make: neighbours make one
    covered: list[tuple[int, ...]] = []

    def settled(pixels: Bytes) -> Any:
        if waiting:
            pixels = geometry.warped(pixels, geometry.origin_of(moves[-waiting:]))
        return pixels if table is None else cv2.LUT(pixels, table[None])

    with _one_thread():
        for each, own in zip(conditions, values, strict=True):
            if each.is_off(own):
                continue
            if each.table is not None:
                added = each.table(*own)
                table = added if table is None else optics.chained(table, added)
            elif each.moves is not None:
                moves.append(each.moves(*own))
                waiting += 1
            elif each.change is not None:
                image, table, waiting = settled(image), None, 0
                image = _checked(each, each.change(image, own, _generator(seed, each.name)), image)
                if each.covers is not None:
                    covered.append(each.covers(*own, columns, rows))
        image = settled(image)
    return Developed(image, geometry.composed([target for target, _ in moves]), tuple(covered))


def _generator(seed: Sequence[int], name: str) -> np.random.Generator:
    return np.random.default_rng([*seed, zlib.crc32(name.encode())])


def _checked(condition: Condition, changed: Any, image: Bytes) -> Bytes:
    is_image = isinstance(changed, np.ndarray) and changed.dtype == np.uint8
    if not is_image or changed.shape != image.shape:
        got = f"{changed.dtype} {changed.shape}" if isinstance(changed, np.ndarray) else changed
        raise UserError(
            f"Expected uint8 {image.shape} from the condition {condition.name!r}, got {got!r}. "
            "Return an image like the one that it gets."
        )
    result: Bytes = changed
    return result


def check_opencv() -> None:
    """Raise `MissingExtra` where OpenCV is not installed."""
    try:
        import cv2  # noqa: F401
    except ImportError as error:
        raise MissingExtra(
            f"Expected OpenCV for conditions of images, got: {error}. {install_line('images')}"
        ) from error


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let OpenCV compute in one thread, and without what differs between makers of processors."""
    import cv2

    threads, special = cv2.getNumThreads(), cv2.ipp.useIPP()
    cv2.setNumThreads(1)
    cv2.ipp.setUseIPP(False)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
        cv2.ipp.setUseIPP(special)
