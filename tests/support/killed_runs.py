"""Attacks in processes of their own that are killed early."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any


def killed_early(folder: Path, script: str) -> int:
    """Run a script that attacks into the folder `killed` of a folder, and kill it after 3 queries.

    The script gets the path of `killed` as its argument. Returns how many queries were kept.
    """
    program, out = folder / "run.py", folder / "killed"
    program.write_text(script)
    path = {"PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path])}
    process = subprocess.Popen([sys.executable, str(program), str(out)], env={**os.environ, **path})
    while process.poll() is None and _committed(out / "run.sqlite") < 3:
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    return _committed(out / "run.sqlite")


def check_same_bits(folder: Path, killed: int, script: str, attack_in: Callable[..., Any]) -> None:
    """Kill a run early, and attack again: resumed, with one worker and with two the same comes.

    `attack_in(folder, **options)` attacks as the script does, which asks less than `killed` times.
    """
    assert 3 <= killed_early(folder, script) < killed
    options = {"killed": {"resume": True}, "one": {}, "two": {"workers": 2}}
    runs = [attack_in(folder / name, **chosen) for name, chosen in options.items()]
    for run in runs[1:]:
        assert (run.samples.score == runs[0].samples.score).all()
        assert (run.queries.score == runs[0].queries.score).all()


def _committed(store: Path) -> int:
    try:
        with closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True)) as connection:
            return int(connection.execute("SELECT count(*) FROM evaluation").fetchone()[0])
    except sqlite3.Error:
        return 0
