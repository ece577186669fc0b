"""The oldest Gymnasium that the package allows: the environments keep their contract with it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SUBJECTS = ("envs/test_adversary_env.py", "envs/test_analytic.py", "envs/test_registry.py")


@pytest.mark.slow
def test_the_environments_work_with_the_oldest_gymnasium(tmp_path: Path) -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    minimum = re.search(r'"gymnasium>=([\d.]+)"', text)
    assert minimum is not None
    lowest = minimum[1] if minimum[1].count(".") == 2 else f"{minimum[1]}.0"
    install = ["install", "--quiet", "--no-deps", "--target", str(tmp_path), f"gymnasium=={lowest}"]
    pip = subprocess.run(
        [sys.executable, "-m", "pip", *install], capture_output=True, text=True, check=False
    )
    if pip.returncode:
        pytest.skip(f"pip cannot install Gymnasium {lowest} here: {pip.stderr.strip()[-200:]}")
    first = f"{tmp_path}{os.pathsep}{ROOT}"
    environment = {**os.environ, "PYTHONPATH": first}
    asked = "import gymnasium; print(gymnasium.__version__)"
    version = subprocess.check_output([sys.executable, "-c", asked], env=environment, text=True)
    assert version.strip() == lowest
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k"]
    command += ["not test_registry or Analytic-v0"]
    command += [str(ROOT / "tests" / subject) for subject in SUBJECTS]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-3_000:] + done.stderr
