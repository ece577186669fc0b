"""What all tests share."""

from __future__ import annotations

import os
import subprocess
import sys
from multiprocessing.context import BaseContext
from pathlib import Path

import pytest
from forked import FORKSERVER

import sada_gym  # registers the environments

pytest.register_assert_rewrite("sada_gym.testing")

KERNELS = {
    "SADA-Detection-Car-v0": "envs/detection/renderers/shading.py",
    "SADA-Driving-Straight-v0": "envs/driving/camera/drawing.py",
    "SADA-UAV-3Anchors-v0": "envs/uav/camera/drawing.py",
}
"""A module whose kernels an evaluation on a track compiles, beside others."""
EVALUATE = """
import sys, numpy, sada_gym
application = sada_gym.make_application(sys.argv[1])
application.evaluate(numpy.zeros((1, len(application.parameters))), [0])
"""


def pytest_configure(config: pytest.Config) -> None:
    """Prepare for xdist: its workers get one thread each, and find the kernels compiled."""
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        compile_kernels()


def compile_kernels() -> None:
    """Evaluate once on each track whose kernels have no machine code yet."""
    from sada_gym.compiled import machine_code_folder

    processes = []
    for track, module in KERNELS.items():
        file = Path(sada_gym.__file__).resolve().parent / module
        folder = machine_code_folder(file)
        if folder is not None and not any(folder.rglob("*.nbi")):
            processes.append(subprocess.Popen([sys.executable, "-c", EVALUATE, track]))
    for process in processes:
        process.wait()


@pytest.fixture(autouse=True)
def fresh_processes_share_imports(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `in_fresh_process` fork from one process that has imported the libraries and no more."""

    def context() -> BaseContext:
        return FORKSERVER

    monkeypatch.setattr("sada_gym.testing.processes.spawn_context", context)
