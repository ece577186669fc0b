"""What all tests share."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
from collections.abc import Iterator
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any

import sada_gym  # isort: skip - registers the environments; first, as it chooses the kernels

import numpy as np
import pytest
from forked import FORKSERVER

pytest.register_assert_rewrite("sada_gym.testing")

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
DRIVER = shutil.which("chromedriver")
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
    from sada_gym.foundations.compiled import machine_code_folder

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


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Open a headless Chromium; skip where it is not installed, unless it is needed."""
    if CHROMIUM is None or DRIVER is None:
        text = "Chromium and its driver are not installed: apt-get install chromium chromium-driver"
        if os.environ.get("SADA_GYM_NEEDS_BROWSER"):
            pytest.fail(text)
        pytest.skip(text)
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for switch in ("headless=new", "no-sandbox", "disable-dev-shm-usage", "hide-scrollbars"):
        options.add_argument(f"--{switch}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture
def bare_python(tmp_path: Path) -> str:
    """A Python that has NumPy, and nothing else that is installed here."""
    venv.create(tmp_path / "bare", with_pip=False)
    packages = next((tmp_path / "bare").rglob("site-packages"))
    home = Path(np.__file__).parents[1]
    for name in ("numpy", "numpy.libs"):
        if (home / name).exists():
            (packages / name).symlink_to(home / name)
    return str(next((tmp_path / "bare").glob("[bS]*/python*")))
