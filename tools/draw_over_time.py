"""Draw docs/images/over-time.svg: how often weak and strong wind fools the agent, at each knot.

    python -m tools.draw_over_time

The application is the first one of docs/over-time.md.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sada_gym import GymnasiumApplication
from sada_gym.analyses.plots.style import FOOLED, UNHURT, new_figure, svg, tidy
from sada_gym.foundations.drawing import own_style
from sada_gym.measures.rates import wilson_interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sada_gym.foundations.arrays import Bools, Floats

DOCS = Path(__file__).parents[1] / "docs"
OUT = DOCS / "images" / "over-time.svg"
WORLDS, SEED = 1_000, 0
QUARTERS = (("weak wind then", 0.0, UNHURT), ("strong wind then", 0.75, FOOLED))
"""The lowest and the highest quarter of the wind's strength in μ, from its lower end on."""


@own_style()
def draw(mu: Floats, fooled: Bools) -> Figure:
    """Draw the failure rate where the wind at a knot is weak, and where it is strong."""
    knots = np.linspace(0.0, 100.0, mu.shape[1])
    figure = new_figure(6.4, 2.8)
    axes = figure.subplots()
    for (label, low, colour), shift in zip(QUARTERS, (-0.8, 0.8), strict=True):
        inside = (np.abs(mu) >= low) & (np.abs(mu) < low + 0.25)
        counts = [(int(fooled[there].sum()), int(there.sum())) for there in inside.T]
        rates = np.array([100 * k / n for k, n in counts])
        ends = 100 * np.array([wilson_interval(k, n) for k, n in counts]).T
        bars = np.abs(ends - rates)
        axes.errorbar(knots + shift, rates, bars, color=colour, fmt="o-", lw=1.6, ms=6, label=label)
        print(label, [f"{rate:.0f}" for rate in rates])
    axes.set(
        xlabel="time of the wind: share of the episode (%)",
        ylabel="fails (%)",
        ylim=(0, 102),
        xticks=knots,
    )
    tidy(axes, grid="y")
    axes.legend(frameon=False, loc="lower right")
    return figure


def main() -> None:
    """Evaluate uniform worlds of the page's application, and draw their failures."""
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
    OUT.write_bytes(svg(draw(mu, score <= 0.5)))
    print(f"{(score <= 0.5).sum()} of {WORLDS} worlds fail")


if __name__ == "__main__":
    main()
