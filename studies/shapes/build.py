"""Make the file of the benchmark's 100 shapes: `python -m studies.shapes.build --out FILE`.

The package holds that file as `sada_gym/envs/detection/shapes/benchmark.npz`, and `catalogue.py`
beside it holds the SHA-256. Another processor may round a few coordinates differently, and another
zlib may compress differently: the shapes in the package's file are the benchmark's.
"""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.shapes.catalogue import CLASSES
from studies.shapes.catalogue import BENCHMARK_COUNT, generate


def arrays() -> dict[str, npt.NDArray[Any]]:
    """Return all arrays of the file by name, as `sada_gym.envs.detection.shapes.catalogue` says."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    for name in CLASSES:
        shapes = [generate(name, seed) for seed in range(BENCHMARK_COUNT[name])]
        arrays |= {
            f"{name}.names": np.array([shape.name for shape in shapes]),
            f"{name}.sizes": np.array([(len(s.vertices), len(s.faces)) for s in shapes], "<i4"),
            f"{name}.vertices": np.concatenate([shape.vertices for shape in shapes]),
            f"{name}.normals": np.concatenate([shape.normals for shape in shapes]),
            # no shape has as many as 2**16 vertices, and half as many bytes compress better
            f"{name}.faces": np.concatenate([shape.faces for shape in shapes]).astype("<u2"),
            f"{name}.materials": np.concatenate([shape.materials for shape in shapes]),
        }
    return arrays


def write(path: Path) -> str:
    """Write the file, without the time of day; give its SHA-256."""
    np.savez_compressed(path, **arrays())  # type: ignore[arg-type]
    return hashlib.sha256(path.read_bytes()).hexdigest()


def main() -> None:
    """Write the file, and print its SHA-256."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="the .npz file to write")
    print(write(parser.parse_args().out))


if __name__ == "__main__":
    main()
