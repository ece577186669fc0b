"""Faults of a camera whose pictures the agent sees: the conditions of `ImageApplication`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from sada_gym.envs.wrapped.disturbances import ChangedObservations, Env, Generator, Sensor
from sada_gym.envs.wrapped.events import Passing
from sada_gym.envs.wrapped.factory import EnvFactory
from sada_gym.envs.wrapped.profiles import Profile, now
from sada_gym.envs.wrapped.timed import Occurrence, Timed
from sada_gym.errors import UserError, check_known
from sada_gym.foundations.lazy import load
from sada_gym.parameters import Parameter

_NEW_IN_EACH_PICTURE = ("noise", "rain", "snow")
"""What is drawn anew for each picture; dirt, dead rows and shadows stay where they are."""


class _FaultyPictures(Passing, ChangedObservations):
    condition: Any

    @cached_property
    def _seed(self) -> int:
        return int(self.rng.integers(2**63))

    def changed(self, number: Any, key: str | None) -> Any:  # noqa: ARG002
        if not self.active:
            return number
        given = np.asarray(number)
        first = given.ndim == 3 and given.shape[0] in (1, 3) and given.shape[-1] not in (1, 3)
        picture = np.moveaxis(given, 0, -1) if first else given
        flat = picture.ndim == 2
        picture = picture[..., None] if flat else picture
        grey = picture.shape[-1] == 1
        whole = np.ascontiguousarray(np.repeat(picture, 3, axis=-1) if grey else picture)
        moving = self.condition.name in _NEW_IN_EACH_PICTURE
        seed = (self._seed, self.time) if moving else (self._seed,)
        developed = load("sada_gym.envs.images.conditions:developed")
        of_fault = self.value if isinstance(self.value, tuple) else (self.value,)
        values = tuple(now(value, self.curve_step) for value in of_fault)
        seen = developed(whole, (self.condition,), (values,), seed).image
        seen = seen[..., :1] if grey else seen
        seen = seen[..., 0] if flat else seen
        return np.moveaxis(seen, -1, 0) if first else seen


@dataclass(frozen=True)
class CameraFault(Timed, Sensor):
    """Pictures that the agent sees get worse, because of the lens, the sensor or the weather.

    The parameters and ranges are those of this condition of `ImageApplication`. The first parameter
    has the fault's name; `low` and `high` may narrow its range, and `knots` make it a curve. It
    needs the extra `images`.

    Attributes:
        condition: "defocus", "motion_blur", "exposure", "dead_rows", "occluder" or another
            condition of `ImageApplication`.
    """

    varies: ClassVar[bool] = True
    layer: ClassVar[float] = 2.7
    condition: str = "defocus"

    @property
    def valued(self) -> bool:
        """It always has values."""
        return True

    @property
    def _parameters(self) -> tuple[Parameter, ...]:
        first, *others = self._condition.parameters
        if self.low is not None or self.high is not None:
            low, high = self._range(self.condition)
            first = replace(first, low=low, high=high)
        return tuple(self._at_knots(first, *others))

    def _at_knots(self, first: Any, *others: Any) -> list[Any]:
        """Return the first parameter's at each knot, and the others'."""
        return [*[first] * (self.knots or 1), *others]

    @property
    def _condition(self) -> Any:
        conditions = load("sada_gym.envs.images.conditions:CONDITIONS")
        check_known("condition of a camera", [self.condition], [*conditions])
        return conditions[self.condition]

    @property
    def count(self) -> int:
        """How many parameters the condition has, and its steps."""
        return len(self._parameters) + len(self._times)

    def looks_like_angle(self) -> bool:
        """No: conditions say what they are."""
        return False

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """Return those of the condition, and of its steps."""
        if self.choices or self.integer or self.log or self.nominal is not None:
            raise UserError(
                f"Expected low and high alone, or no range, of the fault {name!r}: its condition "
                f"{self.condition!r} says what its parameters are."
            )
        times = [when.parameter(f"{name}_{key}") for key, when in self._times.items()]
        names = self._value_names(name)
        own = (replace(p, name=n) for p, n in zip(self._parameters, names, strict=True))
        return (*own, *times)

    def _value_names(self, name: str) -> list[str]:
        others = self._condition.parameters[1:]
        return [*self._own_names(name), *(f"{name}_{one.name}" for one in others)]

    def named(self, name: str, values: Any) -> dict[str, Any]:
        """Return the values and the steps by the names of their parameters."""
        first, *others = values.value if isinstance(values, Occurrence) else values
        own = [*(first.values if isinstance(first, Profile) else [first]), *others]
        times = {f"{name}_{key}": getattr(values, key) for key in self._times}
        return dict(zip(self._value_names(name), own, strict=True)) | times

    def world_value(self, numbers: Sequence[float]) -> Any:
        """Return the values of the condition in an episode."""
        split = len(self._parameters)
        own, first = tuple(map(float, numbers[:split])), self.knots or 1
        curve = own[0] if self.over is None else Profile(own[:first], self.over, self.curve)
        return self._in_time((curve, *own[first:]), numbers[split:])

    def value(self, physical: float) -> float:
        """Return the value itself."""
        return physical

    def places(self, name: str, factory: EnvFactory, env: Env) -> list[float | None]:  # noqa: ARG002
        """Return the values in ordinary pictures."""
        nominal = self._at_knots(*self._condition.nominal)
        pairs = zip(self._parameters, nominal, strict=True)
        inside = [value if one.low <= value <= one.high else None for one, value in pairs]
        return [*inside, *self._middle_times.values()]

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:
        """Check that the agent sees pictures."""
        load("sada_gym.envs.images.conditions:check_opencv")()
        super().check(name, factory, env)
        for box in self.boxes(env.observation_space).values():
            shape = box.shape
            channels = {1, 3} & {shape[-1], shape[0]} if len(shape) == 3 else {1}
            if box.dtype != np.uint8 or len(shape) not in (2, 3) or not channels or self.entries:
                raise UserError(
                    f"Expected pictures in {factory.name} for the camera's fault {name!r}, of "
                    f"bytes and with one or three channels, got {box}. Name the key of one, "
                    "key='camera', and no entries."
                )

    def boxes(self, space: Any) -> dict[str | None, Any]:
        """Return the pictures by their keys."""
        found = super().boxes(space)
        if found or self.key is not None:
            return found
        return {key: box for key, box in space.items() if len(box.shape or ()) in (2, 3)}

    def targets(self, name: str) -> tuple[Any, ...]:
        """Return one target each."""
        return (name,)

    def wrap(self, env: Env, value: Any, rng: Generator) -> Env:
        """Let the camera see worse."""
        wrapper = _FaultyPictures(env, value, rng)
        wrapper.among(self.boxes(env.observation_space), None)
        wrapper.condition = self._condition
        return wrapper
