"""Draw docs/images/over-time.svg, the wind of the worlds that fail and of those that pass.

    python -m tools.draw_over_time

The application is the first one of docs/over-time.md.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym import GymnasiumApplication
from sada_gym.analyses.plots.curves import curves
from sada_gym.analyses.plots.style import svg
from sada_gym.evaluations import Evaluations

DOCS = Path(__file__).parents[1] / "docs"
OUT = DOCS / "images" / "over-time.svg"
WORLDS, SEED = 500, 0


def main() -> None:
    """Evaluate uniform worlds of the page's application, and draw their curves."""
    page = (DOCS / "over-time.md").read_text(encoding="utf-8")
    block = re.search(r"^```python\n(.*?)^application = ", page, re.DOTALL | re.MULTILINE)
    (wind,) = re.findall(r'^        "wind": (Force\(.*\)),$', page, re.MULTILINE)
    assert block is not None
    names: dict[str, Any] = {}
    exec(block[1] + f"wind = {wind}\n", names)
    application = GymnasiumApplication(
        "CartPole-v1",
        agent=names["balance"],
        agent_id="by hand",
        parameters={"wind": names["wind"]},
        score=("length", 500),
        fooling_threshold=0.5,
    )
    rng = np.random.default_rng(SEED)
    mu = rng.uniform(-1.0, 1.0, (WORLDS, len(application.parameters))).astype(np.float32)
    seeds = np.arange(WORLDS, dtype=np.uint64)
    score = application.evaluate(mu, seeds.tolist()).score
    figure = curves(application.parameters, application.curves, Evaluations(mu, score, seeds), 0.5)
    figure.suptitle("")  # the page's caption says it
    OUT.write_bytes(svg(figure))
    print(f"{(score <= 0.5).sum()} of {WORLDS} worlds fail")


if __name__ == "__main__":
    main()
