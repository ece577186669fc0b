"""Draw docs/images/own-adversary.png and own-optimiser.png: what they sample on a known plane.

    python -m tools.draw_own_adversary

The plane, the budget and the seed are those of `tools.draw_adversaries`. `BoundingBox` is the first
class of docs/own-adversary.md; the others are those of the examples. It needs the extra `examples`.
"""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import optuna

from sada_gym import adversaries
from sada_gym.analyses.plots.style import new_figure, png
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK, MUTED
from sada_gym.oracle import Oracle
from tools.draw_adversaries import (
    BUDGET,
    OUT,
    SAMPLES,
    SEED,
    Panel,
    coverage,
    draw_boxes,
    draw_legend,
    draw_samples,
)

ROOT = Path(__file__).parents[1]
VOLUME = 0.1


def of_the_page() -> Any:
    """Return the first adversary of the page."""
    page = (ROOT / "docs" / "own-adversary.md").read_text(encoding="utf-8")
    block = re.search(r"^```python\n(.*?)^run = ", page, re.DOTALL | re.MULTILINE)
    assert block is not None
    names: dict[str, Any] = {}
    exec(block[1], names)
    return names["BoundingBox"]


def of_example(name: str) -> dict[str, Any]:
    """Return the names of an example."""
    return runpy.run_path(str(ROOT / "examples" / f"{name}.py"))


@own_style()
def draw(name: str, panels: dict[str, Any]) -> None:
    """Draw a map for each adversary, and print how often it fools and how much it covers."""
    application = AnalyticApplication(dimension=2, volume=VOLUME)
    figure = new_figure(9, 3.9)
    for axes, (title, adversary) in zip(figure.subplots(1, 3), panels.items(), strict=True):
        with Oracle(application, budget=BUDGET, seed=SEED) as oracle:
            adversary.train(oracle)
        mu = adversary.sample(SAMPLES)
        fooled = application.evaluate(mu, [0] * len(mu)).fooled
        draw_boxes(axes, application)
        draw_samples(axes, mu, fooled)
        said = f"{fooled.mean():.0%} fool, {coverage(mu, fooled, application):.0%} covered"
        axes.set_title(title, fontsize=11, color=INK, pad=20)
        axes.text(0, 1.05, said.replace("%", " %"), fontsize=9, color=MUTED, ha="center")
        print(f"{title}: {said}", flush=True)
    draw_legend(figure, tuple(map(Panel, panels)))
    figure.get_layout_engine().set(rect=(0, 0, 1, 0.96))
    (OUT / f"{name}.png").write_bytes(png(figure))


def main() -> None:
    """Draw both pictures."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    level_set = adversaries.make("level-set", 2, seed=SEED)
    box, around = of_the_page(), of_example("own_adversary")["Neighbourhood"]
    own = {"BoundingBox": box(2, seed=SEED), "Neighbourhood": around(2, seed=SEED)}
    draw("own-adversary", {**own, "level-set": level_set})
    names = of_example("compare_optimisers")
    optimisers = {"TPE": names["TPE"](2, seed=SEED), "CMA-ES": names["CMAES"](2, seed=SEED)}
    level_set = adversaries.make("level-set", 2, seed=SEED)
    draw("own-optimiser", {**optimisers, "level-set": level_set})


if __name__ == "__main__":
    main()
