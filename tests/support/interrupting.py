"""Child processes that a test can stop as Ctrl-C does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence


def start_interruptible(command: Sequence[str], **environment: str) -> subprocess.Popen[str]:
    """Start `python -m sada_gym` in a process group of its own; it heeds SIGINT in any case.

    A shell that runs the tests in the background, or `nohup`, makes its children ignore SIGINT, and
    theirs inherit that.

    Args:
        command: What follows `python -m sada_gym`.
        environment: Variables to add.
    """
    path = {"PYTHONPATH": os.pathsep.join(sys.path), "COLUMNS": "200"}
    return subprocess.Popen(
        [sys.executable, "-m", "sada_gym", *command],
        env={**os.environ, **path, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
