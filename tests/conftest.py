"""What all tests share."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

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
    """Compile the kernels before xdist starts its workers: else each would compile them all."""
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
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
