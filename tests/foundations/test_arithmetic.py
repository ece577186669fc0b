import json
import os
import subprocess
import sys
import warnings
from functools import cache
from pathlib import Path

import pytest
from families import family
from make_digests import FILE, digest, libm

from sada_gym import make_application
from sada_gym.adversaries import registry
from sada_gym.experiment.packages import installed, packages
from sada_gym.foundations.arithmetic import CANONICAL, arithmetic, warn_of_others
from sada_gym.foundations.cards import cards
from sada_gym.foundations.registration import tracks

DIGESTS = json.loads(FILE.read_text())
FAST = ("SADA-Detection-Bus-v0", "SADA-Digits-3-v0")
LONG = (
    "SADA-Detection-Car-v0",
    "SADA-Driving-Straight-v0",
    "SADA-UAV-3Anchors-v0",
    "SADA-Robot-Warehouse-v0",
)
VARIABLES = (
    "MKL_CBWR",
    "ONEDNN_MAX_CPU_ISA",
    "ATEN_CPU_CAPABILITY",
    "NPY_DISABLE_CPU_FEATURES",
    "OPENBLAS_CORETYPE",
)
PRODUCT = """
import hashlib, sys
for name in sys.argv[1:]:
    if name == "compute":
        torch.ones(3, 3) @ torch.ones(3, 3)
    else:
        globals()[name] = __import__(name)
import sada_gym, torch
from sada_gym.foundations.arithmetic import arithmetic
torch.manual_seed(0)
product = torch.randn(16, 300) @ torch.randn(300, 256)
print(arithmetic(), hashlib.sha256(product.numpy().tobytes()).hexdigest()[:16], sep=";")
"""
CPU = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
HAS_OTHER_ROOTS = "amx_tile" in CPU or "GenuineIntel" not in CPU
"""Whether MKL's roots, which begin with the processor's own approximation, are not the digests'."""
needs_avx2 = pytest.mark.skipif(
    arithmetic() != CANONICAL, reason=f"This machine has another arithmetic: {arithmetic()}."
)


@cache
def product(*before, **variables):
    """Import and compute in a process of its own; return its arithmetic and a product's digest."""
    inherited = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    done = subprocess.run(
        [sys.executable, "-c", PRODUCT, *before],
        env=inherited | variables,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip().split(";")


@pytest.fixture
def canonical():
    return product()


@needs_avx2
@pytest.mark.parametrize(
    "track",
    [
        *family([track for track in DIGESTS["attacks"] if track not in LONG], *FAST),
        *(pytest.param(track, marks=pytest.mark.long) for track in LONG),
    ],
)
def test_an_attack_is_the_same_on_all_processors(track):
    if libm() != DIGESTS["libm"]:
        pytest.skip(
            "This machine's mathematics library rounds otherwise than the one of the digests."
        )
    found = digest(track)
    if found != DIGESTS["attacks"][track] and found.startswith("bbgan") and HAS_OTHER_ROOTS:
        pytest.skip("Adam takes square roots, which this processor begins with other last bits.")
    assert found == DIGESTS["attacks"][track]


def test_each_track_has_a_digest():
    repeatable = {track for card in cards() if card.repeatable for track in card.track_ids}
    assert set(DIGESTS["attacks"]) == repeatable & set(tracks())


@needs_avx2
@pytest.mark.parametrize("before", ["numpy", "torch"])
def test_what_is_loaded_before_computes_with_the_same_kernels(before, canonical):
    found = product(before)
    assert found[1] == canonical[1]
    if before in ("numpy", "torch") and found[0] == "this processor's own of NumPy":
        pytest.skip("NumPy has wider kernels here, and chose them when it, or torch, was loaded.")
    assert found == canonical == [CANONICAL, canonical[1]]


@needs_avx2
def test_what_has_computed_before_keeps_its_kernels_and_says_so():
    assert product("torch", "compute")[0].startswith("this processor's own of")


@needs_avx2
def test_a_users_own_choice_stays(canonical):
    chosen, other = product(MKL_CBWR="AUTO"), product("torch", "compute")
    assert chosen[0].endswith("MKL")
    assert other[0].endswith("MKL")
    assert chosen[1] != canonical[1]


def test_a_run_records_its_arithmetic():
    application = make_application("SADA-Analytic-v0")
    recorded = packages(application, registry.find("random"))
    assert recorded["arithmetic"] == arithmetic() == installed("arithmetic")
    assert installed("no-such-package") == "not installed"


def test_other_kernels_are_told_once_with_what_fixes_it():
    with pytest.warns(UserWarning, match=r"got this processor's own of MKL.*MKL_CBWR='COMPATIBLE'"):
        warn_of_others("this processor's own of MKL")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_others(CANONICAL)
        warn_of_others("arm64")
