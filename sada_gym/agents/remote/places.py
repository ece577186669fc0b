"""Where an agent's process is: at an address, or a program that is started for the attack."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, cast

from sada_gym.agents.remote import keeper
from sada_gym.agents.remote.messages import Channel
from sada_gym.errors import UserError, UserTypeError
from sada_gym.foundations.files import shown
from sada_gym.foundations.serve_environment import CONNECT, CONNECT_UNIX

_TCP = re.compile(r"tcp://(\[[0-9a-fA-F:]+\]|[^\s:/\[\]]+):(\d{1,5})")
_LOOK_EACH_S = 0.2
_ENDING_S = 10.0


class Unreachable(Exception):  # noqa: N818 - reads as what happened
    """Nobody answers at a place; the message says why."""


@dataclass
class Link:
    """An open connection, and the program that was started for it, if any."""

    channel: Channel
    program: subprocess.Popen[bytes] | None = None

    def close(self) -> str:
        """Close the connection, end the program, and return the last that it printed."""
        self.channel.close()
        return "" if self.program is None else _ended(self.program)


@dataclass(frozen=True)
class Address:
    """An address `tcp://host:port` at which a server waits."""

    host: str
    port: int

    def __str__(self) -> str:
        """Name it for messages."""
        return shown(f"tcp://{self.host}:{self.port}")

    @property
    def name(self) -> str:
        """What reports call an agent here that has no name."""
        return shown(f"{self.host}:{self.port}")

    def open(self, timeout_s: float, start: str = "") -> Link:
        """Connect; raise `Unreachable` if nobody is there: `start` says how to start a server."""
        try:
            link = socket.create_connection((self.host.strip("[]"), self.port), timeout_s)
        except (OSError, ValueError) as error:  # a host's name may be none that can be written
            raise Unreachable(f"nothing answers there ({error}). {start}") from error
        return Link(Channel(link, timeout_s))


@dataclass(frozen=True)
class Program:
    """A command that starts an agent's program, in a folder; each process starts its own.

    The program connects to the address in its environment variable `SADA_GYM_CONNECT`, and ends
    with the process that started it.
    """

    command: tuple[str, ...]
    folder: str

    def __str__(self) -> str:
        """Name it for messages."""
        return f"the program {shown(' '.join(self.command))}"

    @property
    def name(self) -> str:
        """What reports call an agent here that has no name."""
        files = [part for part in self.command[1:] if not part.startswith("-")]
        return Path((files or self.command)[0]).stem

    def open(self, timeout_s: float, start: str = "") -> Link:  # noqa: ARG002
        """Start the program and wait until it connects; raise `Unreachable` if it does not."""
        with ExitStack() as stack:
            waiting = [stack.enter_context(socket.create_server(("127.0.0.1", 0)))]
            port = waiting[0].getsockname()[1]
            environment = {CONNECT: f"127.0.0.1:{port}", "PYTHONUNBUFFERED": "1"}
            if (unix := _unix_socket(stack)) is not None:
                waiting.append(unix)
                environment[CONNECT_UNIX] = unix.getsockname()
            command = [sys.executable, "-I", "-S", keeper.__file__, self._executable]
            try:
                program = subprocess.Popen(
                    [*command, *self.command[1:]],
                    cwd=self.folder,
                    env={**_outer_environment(), **environment},
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                )
            except (OSError, ValueError) as error:  # no such folder, or a NUL in the command
                raise Unreachable(f"it did not start ({error})") from error
            try:
                connection = _awaited(waiting, program, timeout_s)
                return Link(Channel(connection, timeout_s), program)
            except BaseException:
                _ended(program)
                raise

    @property
    def _executable(self) -> str:
        """The program's file; `python` alone is the Python that runs here."""
        given = os.path.expanduser(self.command[0])
        if given == "python":
            return sys.executable
        beside = os.path.join(self.folder, given)
        if os.path.dirname(given) and os.path.isfile(beside):
            return beside
        found = shutil.which(given)
        if found is None:
            raise Unreachable(f"there is no program {given!r} on the path. Name its file")
        return found


def place_of(given: Any, folder: str | Path = ".", role: str = "agent") -> Address | Program | None:
    """Return the address or the program that a text or a list names; None of anything else.

    `folder` is where programs start; `role` is what messages call it. It raises `UserError` if it
    is a list of no texts, or a `tcp://` without host and port.
    """
    if isinstance(given, Address | Program):
        return given
    if isinstance(given, str) and given.startswith("tcp:"):
        found = _TCP.fullmatch(given)
        if found is None or not 0 < int(found[2]) < 2**16:
            raise UserError(
                f"Expected an address such as 'tcp://127.0.0.1:7788' as the {role}, got {given!r}."
            )
        return Address(found[1], int(found[2]))
    if not isinstance(given, list | tuple):
        return None
    if not given or not all(isinstance(part, str) and part for part in given):
        raise UserTypeError(
            f"Expected a command as the {role}, a list of texts such as ['python', 'serve.py'], "
            f"got {given!r}."
        )
    return Program(tuple(given), os.path.abspath(folder))


def _unix_socket(stack: ExitStack) -> socket.socket | None:
    """Listen on a Unix socket that this user alone can reach; None where there is none."""
    if not hasattr(socket, "AF_UNIX"):
        return None
    try:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="sada-gym-"))
        listening = stack.enter_context(socket.socket(socket.AF_UNIX))
        listening.bind(os.path.join(folder, "agent"))
        listening.listen()
    except OSError:  # no place for files, or a path too long for a socket: TCP is enough
        return None
    return listening


def _outer_environment() -> dict[str, str]:
    """Return our variables without the addresses of an attack that started this process."""
    return {key: value for key, value in os.environ.items() if key not in (CONNECT, CONNECT_UNIX)}


def _awaited(
    waiting: Sequence[socket.socket], program: subprocess.Popen[bytes], timeout_s: float
) -> socket.socket:
    until = time.monotonic() + timeout_s
    while True:
        for ready in wait(waiting, _LOOK_EACH_S):
            return cast(socket.socket, ready).accept()[0]
        status = program.poll()
        if status is not None:
            raise Unreachable(
                f"it ended with status {status} before it connected{printed(_ended(program))}"
            )
        if time.monotonic() > until:
            raise Unreachable(
                f"it did not connect to {CONNECT} within {timeout_s:g} s{printed(_ended(program))}"
            )


def _ended(program: subprocess.Popen[bytes]) -> str:
    """End a program and its keeper, and return the last that it printed."""
    try:
        output, _ = program.communicate(timeout=_ENDING_S)  # closes its input first
    except (subprocess.TimeoutExpired, ValueError):
        program.kill()
        return ""
    return (output or b"").decode(errors="replace").strip()


def printed(last: str) -> str:
    """Return the last lines that a program printed, for a message."""
    lines = [line.strip() for line in last.splitlines() if line.strip(" ^~")][-3:]
    return f". It printed at last: {shown(' / '.join(lines))}" if lines else ""
