"""Runs a command, and ends it when the process that asked for it ends; it needs nothing of ours.

The asking process holds the other end of standard input: when that closes, in whatever way, the
command and all its children are killed. The last of what they printed is written at the end.
"""

import contextlib
import os
import signal
import subprocess
import sys
import threading

_LAST_BYTES = 2_000


def main(command: list[str]) -> int:
    """Run a command, and return its exit status."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the asking process decides what Ctrl-C means
    try:
        child = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as error:
        os.write(1, str(error).encode())
        return 127
    threading.Thread(target=_end_with_parent, args=(child,), daemon=True).start()
    assert child.stdout is not None
    last, output = b"", child.stdout.fileno()
    while chunk := os.read(output, 65_536):
        last = (last + chunk)[-_LAST_BYTES:]
    status = child.wait()
    with contextlib.suppress(OSError):
        os.write(1, last)  # sys.stdout would complain at exit where nobody reads any more
    return status


def _end_with_parent(child: "subprocess.Popen[bytes]") -> None:
    while os.read(0, 1_024):
        pass
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, signal.SIGKILL)
    else:
        child.kill()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
