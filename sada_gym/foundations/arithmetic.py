"""One arithmetic on all x86-64 processors, so that a score is the same to the last bit on each.

NumPy, OpenBLAS and the libraries below torch choose their kernels by processor. Other kernels add
up in another order and round differently, and in a closed loop one last bit makes another episode.
So importing `sada_gym` chooses for them: kernels that every processor with AVX2 has, and MKL's
kernels for the processors of all makers. A library reads the choice when it is loaded (NumPy,
OpenBLAS, OpenCV) or when it first computes (those below torch).
"""

from __future__ import annotations

import ctypes
import os
import platform
import sys
import warnings
from collections.abc import Mapping
from importlib import import_module, metadata
from pathlib import Path

CANONICAL = "AVX2"
"""What `arithmetic` says where all libraries compute with the kernels that we chose."""

_IS_X86 = platform.machine().lower() in ("x86_64", "amd64")
_CHOSEN = {"MKL_CBWR": "COMPATIBLE", "ONEDNN_MAX_CPU_ISA": "AVX2", "ATEN_CPU_CAPABILITY": "avx2"}
_MKL_BRANCH, _MKL_COMPATIBLE = 1, 3
_FIRST_PROCESSOR = 4_096
_WIDER = ("X86_V4", "AVX512")
_OWN = "this processor's own"


def choose() -> None:
    """Choose the kernels, unless a variable below says that the user or our parent process has.

    A worker process computes as its parent does, which may have used NumPy or torch before.
    """
    if not _IS_X86 or not os.environ.keys().isdisjoint(_CHOSEN):
        return
    os.environ.update(_CHOSEN)
    if "numpy" not in sys.modules:
        for name, value in _numpy_variables().items():
            os.environ.setdefault(name, value)
    if "cv2" not in sys.modules and _has_wider():
        os.environ.setdefault("OPENCV_CPU_DISABLE", "AVX512-SKX")
    if _differing_torch():
        del os.environ["MKL_CBWR"], os.environ["ATEN_CPU_CAPABILITY"]
        os.environ["ONEDNN_MAX_CPU_ISA"] = "ALL"


def arithmetic() -> str:
    """Say with which kernels this process computes: `CANONICAL`, or what differs from it."""
    if not _IS_X86:
        return platform.machine()
    numpy = import_module("numpy._core._multiarray_umath")
    features: Mapping[str, bool] = numpy.__cpu_features__
    if not features["AVX2"]:
        return f"{platform.machine()} without AVX2"
    # of features that no kernel is chosen by, NumPy says that they are there all the same
    chosen_by = [name for name in numpy.__cpu_dispatch__ if features[name]]
    wider = any(name.startswith(_WIDER) for name in chosen_by)
    differing = [*(["NumPy"] if wider else []), *_differing_torch()]
    return f"{_OWN} of {' and '.join(differing)}" if differing else CANONICAL


def could_be_canonical(found: str) -> bool:
    """Say whether an `arithmetic` is not the canonical one, but could be on this processor."""
    return found.startswith(_OWN)


def warn_of_others(found: str) -> None:
    """Warn where an `arithmetic` is not the canonical one, and could be."""
    if could_be_canonical(found):
        line = " ".join(f"{k}='{v}'" for k, v in {**_CHOSEN, **_numpy_variables()}.items())
        warnings.warn(
            f"Expected the kernels that all processors with AVX2 share, got {found}, so that "
            "scores can differ from another machine's. Import sada_gym before anything computes, "
            f"or start Python with {line}",
            stacklevel=2,
        )


def _numpy_variables() -> dict[str, str]:
    version = metadata.version("numpy").split(".")
    names = (
        "X86_V4 AVX512_ICL AVX512_SPR"
        if (int(version[0]), int(version[1])) >= (2, 4)
        else "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR"
    )
    return {"NPY_DISABLE_CPU_FEATURES": names, "OPENBLAS_CORETYPE": "Haswell"}


def _has_wider() -> bool:
    """Say whether the processor has what OpenCV's widest kernels need; elsewhere it complains."""
    try:
        with open("/proc/cpuinfo") as file:  # the first processor is enough: there may be hundreds
            return " avx512bw " in file.read(_FIRST_PROCESSOR)
    except OSError:
        return False


def _differing_torch() -> list[str]:
    """Name what computes otherwise below torch, if it is loaded. Asking fixes the choice."""
    torch = sys.modules.get("torch")
    if torch is None:
        return []
    differing = [] if torch.backends.cpu.get_cpu_capability() == "AVX2" else ["torch"]
    library = Path(torch.__path__[0]) / "lib" / "libtorch_cpu.so"
    try:
        branch = ctypes.CDLL(str(library)).mkl_serv_cbwr_get(_MKL_BRANCH)
    except (OSError, AttributeError):  # a build that brings no MKL, or one that we can't ask
        branch = _MKL_COMPATIBLE
    return [*differing, *(["MKL"] if branch != _MKL_COMPATIBLE else [])]


choose()
