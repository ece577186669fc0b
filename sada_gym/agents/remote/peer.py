"""A process that answers questions over a connection: the agent's, or the environment's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NoReturn, TypeVar

from pydantic import TypeAdapter

from sada_gym.agents.remote.messages import Failed, Header
from sada_gym.agents.remote.places import Address, Link, Program, Unreachable, printed
from sada_gym.agents.remote.spaces import Array
from sada_gym.errors import UserError, WorkerError
from sada_gym.foundations.files import shown
from sada_gym.foundations.serve_environment import PROTOCOL, Nonsense

HeaderT = TypeVar("HeaderT", bound=Header)


class Peer:
    """Asks a process, which it starts or connects to, and closes the connection for any nonsense.

    Args:
        place: Where the process is. Each of our processes has a connection of its own, or starts
            the program itself.
        timeout_s: How long to wait for the program's start, and for each whole answer.
    """

    role: ClassVar[str]
    """What messages call it."""
    wanted: ClassVar[str]
    """What messages expect from it."""
    start_it: ClassVar[str]
    """How to start its server."""
    answers: ClassVar[TypeAdapter[Any]]
    """The headers that it may answer with."""
    lost: ClassVar[type[WorkerError]]
    """What it raises where no answer comes."""

    def __init__(self, place: Address | Program, timeout_s: float) -> None:
        self.place, self._timeout_s = place, timeout_s
        self._link: Link | None = None
        self._number = 0

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the connection: another process opens its own."""
        return {**self.__dict__, "_link": None}

    def close(self) -> None:
        """Close the connection, and end the program; the next question opens them again."""
        self._ended()

    def _ended(self) -> str:
        """Close the connection, and return the last that its program printed."""
        link, self._link = self._link, None
        return "" if link is None else link.close()

    def _open(self) -> None:
        try:
            self._link = self.place.open(self._timeout_s, self.start_it)
        except Unreachable as error:
            raise self.lost(f"Expected an {self.role} in {self.place}, but {error}.") from error
        self._number = 0

    def _exchange(
        self, question: Header, arrays: Mapping[str, Array], expected: type[HeaderT]
    ) -> tuple[HeaderT, dict[str, Array]]:
        """Send a message under the next number, and return the answer to it."""
        assert self._link is not None
        self._number += 1
        try:
            until = self._link.channel.deadline()
            numbered = question.model_copy(update={"number": self._number})
            self._link.channel.send(numbered, arrays, until)
            answer = self._link.channel.receive(self.answers, until)
        except TimeoutError:
            self._lose(f"no answer within {self._timeout_s:g} s")
        except (OSError, Nonsense) as error:
            self._lose(f"{error}")
        except BaseException:
            self.close()  # the answer may still come, and would be taken for the next one
            raise
        if answer is None:
            other = f", or speaks another protocol than {PROTOCOL}" if self._number == 1 else ""
            self._lose(f"the end of the connection: the process died, or closed it{other}")
        if isinstance(answer[0], Failed):
            self.close()
            told = shown(" ".join(answer[0].message.split()))
            raise UserError(f"Expected {self.wanted} from {self.place}, got an error: {told}")
        if not isinstance(answer[0], expected) or answer[0].number != self._number:
            self._lose(f"an answer to another question: {shown(repr(answer[0]))}")
        return answer[0], answer[1]

    def _lose(self, got: str) -> NoReturn:
        """Close the connection, and raise that the process is lost."""
        raise self.lost(
            f"Expected answers from the {self.role} in {self.place}, got "
            f"{got}{printed(self._ended())}. Fix or restart it, and continue the run with --resume."
        )
