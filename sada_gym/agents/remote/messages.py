"""The messages between an attack and an agent's process, in the format of `serve_environment`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Literal, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from sada_gym.agents.contract import Task
from sada_gym.agents.remote.spaces import Array, Described, Name
from sada_gym.agents.tile import ALONE
from sada_gym.errors import UserError
from sada_gym.foundations import serve_environment
from sada_gym.foundations.files import Strict, first_error
from sada_gym.foundations.serve_environment import MAX_ARRAY_BYTES, Nonsense

MAX_ROWS = 2**16
OBSERVATION = "observation"
"""The array of observations that are no dictionaries; a part of others is `observation.KEY`."""


class Unexpected(Nonsense):
    """A whole message whose object in JSON is none that is expected."""


class Header(Strict, strict=True):
    """What every message's object has."""

    number: Annotated[int, Field(ge=0, lt=2**63)]
    """A question's number, which its answer repeats."""


class Hello(Header):
    """The first question: what the agent would see and do."""

    type: Literal["hello"] = "hello"
    protocol: Literal[2]
    environment: Name
    observation_space: Described
    action_space: Described
    wrapped_by: Annotated[tuple[Name, ...], Field(max_length=100)]
    action_masks: bool
    deterministic: bool


class HelloImages(Header):
    """The first question to a classifier or a detector of images, see `ImageApplication`."""

    type: Literal["images"] = "images"
    protocol: Literal[2]
    task: Task | None
    input_size: Annotated[int, Field(ge=1)] | None
    imagenet: bool
    device: Name


class Look(Header):
    """A question for what is in an image, its array `image` (height, width, 3) uint8."""

    type: Literal["look"] = "look"


class Act(Header):
    """A question for actions; its arrays are observations and more."""

    type: Literal["act"] = "act"
    start: bool
    count: Annotated[int, Field(ge=0, le=MAX_ROWS)]


class Welcome(Header):
    """The answer to `Hello` and `HelloImages`; `task` and `classes` are those of images."""

    type: Literal["hello"] = "hello"
    protocol: Literal[2]
    name: Name | None = None
    fingerprint: Name | None = None
    rows: Annotated[int, Field(ge=0, le=MAX_ROWS)] = 16
    action_masks: bool = False
    task: Task | None = None
    classes: Annotated[dict[Name, int], Field(max_length=MAX_ROWS)] | None = None


class Actions(Header):
    """The answer to `Act`, whose array is `actions`, and to `Look`.

    A classifier's array is `scores` (K,), a detector's are `boxes` (N, 4), `labels` and `scores`.
    """

    type: Literal["actions"] = "actions"


class Failed(Header):
    """An answer that says what is wrong."""

    type: Literal["error"] = "error"
    message: str


QUESTIONS: TypeAdapter[Hello | Act | HelloImages | Look] = TypeAdapter(
    Annotated[Hello | Act | HelloImages | Look, Field(discriminator="type")]
)
ANSWERS: TypeAdapter[Welcome | Actions | Failed] = TypeAdapter(
    Annotated[Welcome | Actions | Failed, Field(discriminator="type")]
)
HeaderT = TypeVar("HeaderT")


class Channel(serve_environment.Channel):
    """Messages over one connection, whose objects are checked."""

    def send(self, header: Strict, arrays: Mapping[str, Array], until: float) -> None:
        """Send one message; raise OSError if the other side is gone, or does not read it in time.

        It raises `UserError` if the message is too large.
        """
        try:
            self.put(header.model_dump_json().encode(), arrays, until)
        except ValueError as error:
            raise UserError(
                f"Expected at most {MAX_ARRAY_BYTES:,} bytes in a message, but {error}. Let the "
                "server say fewer rows, or shrink the observations by a wrapper."
            ) from error

    def refuse_old(self, sentence: str) -> None:
        """Send an error as a message of the first protocol."""
        self.put_raw(json.dumps({"type": "error", "message": sentence}).encode(), self.deadline())

    def receive(
        self, kinds: TypeAdapter[HeaderT], until: float | None = None
    ) -> tuple[HeaderT, dict[str, Array]] | None:
        """Wait for one message with one of these headers, see `take`.

        It raises `Unexpected` for another header.
        """
        if (message := self.take(until)) is None:
            return None
        try:
            return kinds.validate_json(message[0]), message[1]
        except ValidationError as error:
            raise Unexpected(f"a message with {first_error(error, 'its object')}") from error


def array_name(key: str) -> str:
    """Return the name of the array of a part of the observations, see `keyed`."""
    return OBSERVATION if key == ALONE else f"{OBSERVATION}.{key}"
