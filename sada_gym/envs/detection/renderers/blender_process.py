"""Blender as a process that answers orders: how it is found, started, asked, and ended."""

from __future__ import annotations

import functools
import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy.typing as npt

from sada_gym.envs.detection.renderers.blender_scene import PREFIX
from sada_gym.errors import UserError
from sada_gym.foundations.files import shown

PROGRAM, TIMEOUT = "SADA_GYM_BLENDER", "SADA_GYM_BLENDER_TIMEOUT_S"
"""Environment variables: the path of the program, and the seconds that a picture may take."""
OLDEST = (3, 3)
SCRIPT = Path(__file__).with_name("blender_scene.py")

_INSTALL = (
    "Install it (Debian and Ubuntu: apt-get install blender; elsewhere: https://www.blender.org), "
    f"or set {PROGRAM} to the program's path"
)
_KINDS = {"<f4": "f", "<i4": "i", "|u1": "B"}
"""The types of arrays, as Python's module `array` calls them."""
_VERSION_S = _START_S = 60.0
_LINE, _LAST_WORDS = 2**16, 250
_ENDING_S = 5.0


class BlenderDied(Exception):  # noqa: N818 - reads as what happened
    """Blender ended before it answered; the text says how."""


def find_program(given: str | None = None) -> str:
    """Return the path of Blender: the given one, that of the environment variable, or on the PATH.

    Raises:
        UserError: If there is none.
    """
    named = given or os.environ.get(PROGRAM)
    found = shutil.which(named or "blender")
    if found is None:
        where = f"at {named!r}" if named else "on the PATH"
        raise UserError(f"Expected the program Blender {where}, got none. {_INSTALL}.")
    return os.path.abspath(found)


def version_of(program: str) -> str:
    """Ask Blender for its version, such as `3.4.1`.

    Raises:
        UserError: If the program does not say, or is too old.
    """
    return _version(program, os.stat(program).st_mtime_ns)


@functools.cache
def _version(program: str, _changed: int) -> str:
    try:
        answer = subprocess.run(
            [program, "--version"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_VERSION_S,
            check=False,
        )
        said = answer.stdout.decode(errors="replace")
    except (OSError, subprocess.TimeoutExpired) as error:
        said = str(error)
    numbers = re.search(r"^Blender (\d+)\.(\d+)(\.\d+)?", said, re.MULTILINE)
    if numbers is None:
        raise UserError(
            f"Expected `{program} --version` to print Blender's version, got {shown(said)!r}. "
            f"{_INSTALL}."
        )
    if (int(numbers[1]), int(numbers[2])) < OLDEST:
        oldest = ".".join(map(str, OLDEST))
        raise UserError(
            f"Expected Blender {oldest} or newer, got {numbers[0]} at {program}. {_INSTALL} of a "
            "newer one."
        )
    return numbers[0].removeprefix("Blender ")


class BlenderProcess:
    """A running Blender.

    An order goes in as a line of JSON, followed by the arrays that it lists as `arrays` (name,
    type, length); a line of JSON with the number of bytes that follow, or an error, comes back. The
    process never outlives this one: Linux kills it together with the thread that started it, and
    elsewhere it ends where stdin does.
    """

    def __init__(self, program: str, timeout_s: float) -> None:
        self.owner = os.getpid()
        self._timeout_s, self._folder = timeout_s, ""
        self._timed_out = False
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - `close` closes it
        # Linux counts the thread as the parent: one that ends early must not take Blender along
        main = threading.current_thread() is threading.main_thread()
        self._process = subprocess.Popen(
            [
                *(program, "--background", "--factory-startup", "-noaudio", "--threads", "1"),
                *("--python-exit-code", "1", "--python", str(SCRIPT), "--"),
                *(["--die-with-parent"] if main else []),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            start_new_session=True,  # Ctrl-C is for us: Blender would hand out half a picture
        )
        try:
            self._folder = str(self._exchange(b"", max(timeout_s, _START_S)).get("folder", ""))
        except BaseException:
            self.close()
            raise

    def ask(
        self, order: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]] | None = None
    ) -> bytes:
        """Send an order and return what comes back.

        Raises:
            BlenderDied: If Blender ends before it answers.
            UserError: If it takes too long, or reports an error.
        """
        given = arrays or {}
        listed = [(name, _KINDS[array.dtype.str], array.size) for name, array in given.items()]
        line = json.dumps({**order, "arrays": listed}, allow_nan=False)
        content = b"".join([f"{line}\n".encode(), *(a.tobytes() for a in given.values())])
        try:
            answer = self._exchange(content, self._timeout_s)
            size = int(answer.get("bytes", 0))
            picture: bytes = self._output.read(size)
            if len(picture) < size:
                raise self._death()
            self._log.seek(0)
            self._log.truncate()
            return picture
        except BaseException:  # Ctrl-C too: the next answer would be to this order
            self.close()
            raise

    @property
    def usable(self) -> bool:
        """Whether it was started by this process, not by one that this is a fork of, and runs."""
        return self.owner == os.getpid() and self._process.poll() is None

    @property
    def _output(self) -> Any:
        return self._process.stdout

    def _exchange(self, content: bytes, limit_s: float) -> dict[str, Any]:
        """Send bytes and return the next message, in time."""
        watch = threading.Timer(limit_s, self._time_out)
        watch.daemon = True
        watch.start()
        try:
            assert self._process.stdin is not None
            self._process.stdin.write(content)
            self._process.stdin.flush()
            while line := self._output.readline(_LINE):
                # what else is printed comes from Blender, its add-ons or a wrapper
                if line.startswith(PREFIX.encode()):
                    answer: dict[str, Any] = json.loads(line.removeprefix(PREFIX.encode()))
                    break
                self._log.write(line)
            else:
                raise self._death()
        except OSError as error:  # a broken pipe
            raise self._death() from error
        finally:
            watch.cancel()
        if "error" in answer:
            raise UserError(f"Blender could not draw a scene: {shown(str(answer['error']))}.")
        return answer

    def _time_out(self) -> None:
        self._timed_out = True
        self._kill()

    def _death(self) -> Exception:
        if self._timed_out:
            return UserError(
                f"Expected a picture from Blender within {self._timeout_s:g} s, got none: it was "
                f"stopped. Set {TIMEOUT} to more seconds, or ask for smaller pictures or fewer "
                "samples."
            )
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_ENDING_S)
        self._kill()
        self._log.seek(0)
        said = self._log.read()[-_LAST_WORDS:].decode(errors="replace").strip()
        last = f" Its last words: {shown(said)}." if said else ""
        return BlenderDied(f"it ended with code {self._process.wait()}.{last}")

    def _kill(self) -> None:
        if hasattr(os, "killpg"):
            # the session: a wrapper script may have started the program
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        else:
            self._process.kill()

    def close(self) -> None:
        """End Blender; twice is fine. In a fork of the process that started it, let go of it."""
        for pipe in (self._process.stdin, self._process.stdout, self._log):
            assert pipe is not None
            with suppress(OSError):  # what was still to be written
                pipe.close()
        if self.owner != os.getpid():
            self._process.returncode = 0  # somebody else's child: nobody here waits for it
            return
        if self._process.poll() is None:
            self._kill()
            self._process.wait(_ENDING_S)
        if self._folder:
            shutil.rmtree(self._folder, ignore_errors=True)
