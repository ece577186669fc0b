"""Draw docs/images/stress-env.svg, the likeliest failure of docs/stress-env.md.

    python -m tools.draw_stress_env

It runs the page's code, and replays its likeliest failing episode and the same without wind.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym.analyses.plots.style import FOOLED, UNHURT, new_figure, svg, tidy
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK, MUTED

DOCS = Path(__file__).parents[1] / "docs"
OUT = DOCS / "images" / "stress-env.svg"
LIMIT = 2.4  # m, CartPole-v1 ends there


def searched(paths: list[np.ndarray]) -> dict[str, Any]:
    """Run the page's search; the observations of each evaluated episode go into `paths`."""

    def kept(episode: Any) -> float:
        paths.append(np.array(episode.observations))
        return min(len(episode.actions) / 50, 1.0)

    page = (DOCS / "stress-env.md").read_text(encoding="utf-8")
    block = re.search(r"^```python\n(.*?)^    run = record", page, re.DOTALL | re.MULTILINE)
    assert block is not None
    code = block[1].replace('("length", 50)', "kept")
    names: dict[str, Any] = {"kept": kept, "__name__": "__main__"}
    exec(code, names)
    return names


@own_style()
def main() -> None:
    """Draw the wind and the cart's position over the steps."""
    paths: list[np.ndarray] = []
    names = searched(paths)
    env, best = names["env"], int(np.argmax(names["likelihood"]))
    mu, seed = env.failures.mu[best], int(env.failures.seed[best])
    parameters = env.application.parameters
    calm = parameters.normalised([0.0] * len(parameters))
    scores = []
    shown = []
    for world in (mu, calm):
        scores.append(env.application.evaluate([world], [seed]).score[0])
        shown.append(paths[-1])
    wind = np.ravel(parameters.physical(mu[None]))
    figure = new_figure(6.2, 4.0)
    above, below = figure.subplots(2, 1, sharex=True)
    steps = len(shown[0]) - 1
    above.bar(np.arange(steps), wind[:steps], color=FOOLED, width=0.8)
    above.set_ylabel("wind, m/s")
    looks = ((FOOLED, "with this wind"), (UNHURT, "without wind"))
    for path, (colour, label) in zip(shown, looks, strict=True):
        below.plot(path[:, 0], color=colour, lw=2, label=label)
    below.axhline(LIMIT, color=MUTED, lw=1, ls="--")
    below.text(49.5, LIMIT - 0.06, "end of the track", ha="right", va="top", fontsize=9, color=INK)
    below.set(xlabel="step", ylabel="position of the cart, m", xlim=(-0.6, 50), ylim=(-0.4, 2.7))
    below.legend(loc="upper left", bbox_to_anchor=(0, 0.88), frameon=False, fontsize=9)
    for axes in (above, below):
        tidy(axes, grid="both")
    OUT.write_bytes(svg(figure))
    print(f"{steps} steps, Q {scores[0]:.2f} and {scores[1]:.2f}; {len(env.failures)} failures")


if __name__ == "__main__":
    main()
