"""Draw docs/images/front-SUITE.svg: the verified AFR over coverage of all adversaries.

    python -m tools.draw_fronts

Unlike the charts that `sada-gym benchmark` writes, they show what the verifier measured, and are
light or dark as the reader's page is.
"""

from __future__ import annotations

import re
from pathlib import Path

from leaderboard.tables import ENTRIES, HEADLINES
from sada_gym.board.benchmark.suite import find_suite
from sada_gym.board.results.entry import read_entries
from sada_gym.board.results.front import make_chart

STARTS = {"driving": 0.7, "robot": 0.8}
"""The lowest coverage shown, where most adversaries have nearly all; the page names the others."""
IMAGES = Path(__file__).parents[1] / "docs" / "images"
STYLE = """<style>
:root { --card: #fff; --ink: #1d2329; --soft: #5d6873; --line: #e3e1dc; --steps: #b23a0a;
  --control: #6b7785; --baseline: #0072b2; --bbgan: #b84a00; --rl: #a4447c; --other: #00795a; }
@media (prefers-color-scheme: dark) { :root { --card: #1b1f24; --ink: #e6e8ea; --soft: #a3adb7;
  --line: #353c44; --steps: #ff9351; --control: #9aa5b1; --baseline: #6cc0f5; --bbgan: #ff9351;
  --rl: #e08abb; --other: #3fc39a; } }
svg { background: var(--card); font: 14px system-ui, "DejaVu Sans", sans-serif; }
text { fill: var(--ink); }
.point text { fill: currentColor; paint-order: stroke; stroke: var(--card); stroke-width: 3px; }
.grid { stroke: var(--line); } .tick, .axis, .title { fill: var(--soft); }
.interval { stroke: var(--soft); opacity: .45; } .leader { stroke: currentColor; opacity: .8; }
.steps { fill: none; stroke: var(--steps); stroke-width: 1.5; stroke-dasharray: 5 4; }
.dot { stroke: var(--card); stroke-width: 1.2; } .best text { font-weight: 650; }
.control text { font-style: italic; }
</style>"""
FILLS = {
    "#6b7785": "control",
    "#0072b2": "baseline",
    "#b84a00": "bbgan",
    "#a4447c": "rl",
    "#00795a": "other",
}


def themed(svg: str) -> str:
    """Give a chart the style of this module, whose colours follow the page."""
    for colour, name in FILLS.items():
        svg = svg.replace(colour, f"var(--{name})")
    return re.sub("<style>.*?</style>", STYLE, svg, flags=re.DOTALL)


def main() -> None:
    """Draw a chart for each application."""
    entries = read_entries(ENTRIES)
    for suite, headline in HEADLINES.items():
        tracks = len(find_suite(suite).tracks)
        over = f"mean of {tracks} tracks" if tracks > 1 else "one track"
        title = f"{headline.title}, {over}, verified"
        chart = make_chart(headline.rows(entries), title, STARTS.get(suite, 0.0))
        assert chart is not None
        (IMAGES / f"front-{suite}.svg").write_text(themed(chart.svg()), "utf-8")


if __name__ == "__main__":
    main()
