"""The photographs of SADA-Photos-Street-v0 as a folder of images, for attacks as on one's own.

python -m studies.street_photos --out street
"""

from __future__ import annotations

import argparse
from pathlib import Path

from PIL import Image

from sada_gym.envs.photos.street import street


def main() -> None:
    """Write the frames."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("street"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for i, frame in enumerate(street()):
        Image.fromarray(frame).save(out / f"{i:02d}.png")
    print(f"{i + 1} images in {out}")


if __name__ == "__main__":
    main()
