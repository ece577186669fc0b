"""Draw agent-protocol.svg and own-agent-parameters.svg: `python -m tools.draw_diagrams`.

The first is the sequence of a connection's messages, the second the order in which an episode gets
its parameters. Both are light or dark as their reader's page is.
"""

from __future__ import annotations

from html import escape
from pathlib import Path

IMAGES = Path(__file__).parents[1] / "docs" / "images"
STYLE = """<style>
:root { --ink: #1f2933; --soft: #5b6673; --card: #f4f6f8 }
text { fill: var(--ink); font-family: sans-serif; font-size: 15px; text-anchor: middle }
.name { font-weight: 700; font-size: 17px }
.soft { fill: var(--soft); font-size: 14px }
.left { text-anchor: start }
rect { fill: var(--card); stroke: var(--soft); stroke-width: 1.5 }
.frame { fill: none; stroke-dasharray: 5 4 }
path { fill: none; stroke: var(--soft); stroke-width: 1.8 }
polygon { fill: var(--soft) }
@media (prefers-color-scheme: dark) {
:root { --ink: #e6e9ec; --soft: #a3adb8; --card: #23292f }
}
</style>"""
ATTACK, SERVER = 110, 530
STEP = 74
"""Pixels from one message to the next."""
MESSAGES = (
    (True, "hello", "spaces, action_masks, deterministic"),
    (False, "hello", "protocol 2, name or fingerprint, rows"),
    (True, "act", "number, start, count; arrays observation, episodes"),
    (False, "actions", "the same number; array actions"),
)
REPEATED = 2
"""The messages from this one on are repeated."""
STAGES = (
    ("constructor", ("Keyword",)),
    ("before reset", ("Attribute, Config,", "derived")),
    ("reset", ("ResetOption",)),
    ("after reset", ("Attribute, Function,", "derived")),
    ("each step", ("noise, delays,", "wind, pushes")),
)


def text(x: float, y: float, words: str, kind: str = "") -> str:
    """Return a line of text."""
    look = f' class="{kind}"' if kind else ""
    return f'<text{look} x="{x:g}" y="{y:g}">{escape(words)}</text>'


def arrow(x0: float, x1: float, y: float) -> str:
    """Return a horizontal arrow."""
    back = -14 if x1 > x0 else 14
    head = f"{x1 + back:g},{y - 7:g} {x1:g},{y:g} {x1 + back:g},{y + 7:g}"
    return f'<path d="M{x0:g} {y:g}H{x1 + back:g}"/><polygon points="{head}"/>'


def drawing(width: int, height: int, title: str, parts: list[str]) -> str:
    """Return an SVG file."""
    head = f'<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img" '
    return (
        "\n".join(
            (f'{head}xmlns="http://www.w3.org/2000/svg">', f"<title>{title}</title>", STYLE, *parts)
        )
        + "\n</svg>\n"
    )


def protocol() -> str:
    """Draw the messages of a connection from the top down."""
    bottom, parts = 96 + STEP * len(MESSAGES), []
    for x, name in ((ATTACK, "attack"), (SERVER, "server")):
        parts += [f'<path d="M{x} 48V{bottom}"/>']
        parts += [f'<rect x="{x - 80}" y="8" width="160" height="40" rx="8"/>']
        parts += [text(x, 34, name, "name")]
    for place, (request, kind, holds) in enumerate(MESSAGES):
        y = 104 + STEP * place
        parts += [arrow(*((ATTACK, SERVER) if request else (SERVER, ATTACK)), y)]
        middle = (ATTACK + SERVER) / 2
        parts += [text(middle, y - 10, kind, "name"), text(middle, y + 21, holds, "soft")]
    y, height = 60 + STEP * REPEATED, STEP * (len(MESSAGES) - REPEATED)
    parts += [f'<rect class="frame" x="16" y="{y}" width="608" height="{height}" rx="6"/>']
    parts += [text(26, y + 20, "each", "soft left"), text(26, y + 38, "step", "soft left")]
    title = "The attack sends hello and then act for each step; the server answers each message"
    return drawing(640, bottom + 4, title, parts)


def parameters() -> str:
    """Draw the stages of an episode from the left, and what is set at each."""
    parts, width, gap = [], 148, 20
    for place, (stage, sets) in enumerate(STAGES):
        x = 2 + place * (width + gap)
        parts += [f'<rect x="{x}" y="4" width="{width}" height="92" rx="8"/>']
        parts += [text(x + width / 2, 32, stage, "name")]
        parts += [text(x + width / 2, 58 + 20 * i, line, "soft") for i, line in enumerate(sets)]
        if place:
            parts += [arrow(x - gap, x, 50)]
    title = (
        "When an episode gets its parameters: constructor, before reset, reset, after, each step"
    )
    return drawing(4 + len(STAGES) * (width + gap) - gap, 100, title, parts)


def main() -> None:
    """Write both files."""
    for name, drawn in (("agent-protocol", protocol()), ("own-agent-parameters", parameters())):
        (IMAGES / f"{name}.svg").write_text(drawn, encoding="utf-8")


if __name__ == "__main__":
    main()
