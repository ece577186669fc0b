"""What the conditions of an image cost, beside reading it from a JPEG file.

pytest benchmarks/test_image_conditions_speed.py -s
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

from sada_gym.envs.images.conditions import SETS, developed, find_conditions

pytest.importorskip("cv2")


def best_ms(call: Callable[[], object], repeats: int = 20) -> float:
    """The least time of some calls."""
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return 1_000 * min(times)


def test_the_conditions_of_an_image() -> None:
    """All conditions at once, at 80 % of their ranges, on 640 x 480 px."""
    np.zeros(2**24, np.uint8)  # as a model's arrays do, it lets malloc keep what images need
    rng = np.random.default_rng(0)
    small = rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)
    image = np.asarray(Image.fromarray(small).resize((640, 480), Image.Resampling.BICUBIC))
    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=90)
    reading = best_ms(lambda: np.asarray(Image.open(io.BytesIO(file.getvalue()))))
    print(f"\nreading a JPEG of 640 x 480 px: {reading:.1f} ms")
    for name in SETS:
        chosen = find_conditions(name)
        values = [tuple(float(p.values(0.8)) for p in c.parameters) for c in chosen]
        own = chosen, values
        took = best_ms(lambda own=own: developed(image, *own, (0,)))
        print(
            f"{name}, {len(chosen)} conditions: {took:.1f} ms, {took / reading:.1f} times reading"
        )
        assert developed(image, chosen, values, (0,)).image.shape == image.shape
