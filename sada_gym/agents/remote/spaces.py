"""Observation and action spaces as data for JSON; bounds that differ are arrays beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from pydantic import Field, ValidationError, model_validator

from sada_gym.errors import UserError
from sada_gym.foundations import serve_environment
from sada_gym.foundations.files import OneLine, Strict, first_error, shown
from sada_gym.foundations.serve_environment import DTYPES

MAX_SPACE_BYTES = 2**24
"""The limit of one observation: a server keeps several arrays of this size for a connection."""

DType = Literal["BOOL", "U8", "U16", "U32", "U64", "I8", "I16", "I32", "I64", "F16", "F32", "F64"]
Array = npt.NDArray[Any]
Name = Annotated[OneLine, Field(max_length=200)]
_Bound = int | float | str | None


class Numbers(Strict, strict=True):
    """A space of arrays of numbers from `low` to `high`, both included.

    A bound is one number, null where it is infinite, or the name of an array of the message.
    """

    kind: Literal["Box", "Discrete", "MultiDiscrete", "MultiBinary"]
    shape: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(max_length=16, strict=False)]
    dtype: DType
    low: _Bound
    high: _Bound

    @property
    def size(self) -> int:
        """The bytes of one observation."""
        return math.prod(self.shape) * DTYPES[self.dtype].itemsize

    @model_validator(mode="after")
    def _is_small(self) -> Numbers:
        if max(self.size, *self.shape, 0) > MAX_SPACE_BYTES:
            raise ValueError(f"expected at most {MAX_SPACE_BYTES:,} bytes, got {self.size:,}")
        return self

    def made(self, arrays: Mapping[str, Array]) -> spaces.Space[Any]:
        """Make the space; raise what Gymnasium and NumPy raise for bounds that are none."""
        low, high = (
            arrays[bound] if isinstance(bound, str) else infinite if bound is None else bound
            for bound, infinite in ((self.low, -np.inf), (self.high, np.inf))
        )
        dtype = DTYPES[self.dtype].type
        if self.kind == "Box":
            return spaces.Box(low, high, self.shape, dtype)
        if self.kind == "MultiBinary":
            return spaces.MultiBinary(self.shape if len(self.shape) > 1 else self.shape[0])
        if self.kind == "Discrete":
            start = int(low)
            return spaces.Discrete(int(high) - start + 1, start=start, dtype=dtype)
        starts, ends = (np.broadcast_to(np.asarray(end, dtype), self.shape) for end in (low, high))
        return spaces.MultiDiscrete(ends - starts + 1, dtype, start=starts)


class Parts(Strict, strict=True):
    """A dictionary of them."""

    kind: Literal["Dict"]
    parts: Annotated[dict[Name, Numbers], Field(max_length=1_000)]

    @model_validator(mode="after")
    def _is_small(self) -> Parts:
        if (size := sum(part.size for part in self.parts.values())) > MAX_SPACE_BYTES:
            raise ValueError(f"expected at most {MAX_SPACE_BYTES:,} bytes, got {size:,}")
        return self

    def made(self, arrays: Mapping[str, Array]) -> spaces.Space[Any]:
        """Make the space, see `Numbers`."""
        return spaces.Dict({key: part.made(arrays) for key, part in self.parts.items()})


Described = Annotated[Numbers | Parts, Field(discriminator="kind")]


def describe(space: spaces.Space[Any], name: str, arrays: dict[str, Array]) -> Numbers | Parts:
    """Describe a space; bounds that differ are put into `arrays`, under names after its own.

    Raises:
        UserError: If it is no space of numbers, or flat dictionary of them, or too large.
    """
    try:
        described = serve_environment.describe(space, name, arrays)
        return (Parts if described["kind"] == "Dict" else Numbers).model_validate(described)
    except ValidationError as error:
        raise UserError(
            f"Expected spaces that can be sent to an agent's process, got {shown(str(space))}: "
            f"{first_error(error, name)}. Change them by a wrapper."
        ) from error
