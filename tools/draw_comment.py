"""Draw docs/images/regress-comment.png, the comment of the lander's tutorial in a pull request.

    python -m tools.draw_comment

The text is what `sada-gym regress --markdown` wrote in docs/tutorials/lander.ipynb, up to its first
world. It needs markdown-it-py and chromium.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from markdown_it import MarkdownIt
from PIL import Image

DOCS = Path(__file__).parents[1] / "docs"
OUT = DOCS / "images" / "regress-comment.png"
WIDTH, MARGIN = 860, 16
PAGE = """<meta charset="utf-8"><style>
body {{ margin: {margin}px; width: {width}px; font: 15px/1.45 sans-serif; color: #1f2933 }}
.comment {{ border: 1px solid #8a949e; border-radius: 8px; overflow: hidden }}
.by {{ background: #eef1f4; border-bottom: 1px solid #8a949e; padding: 8px 16px }}
.text {{ padding: 4px 16px 12px }}
table {{ border-collapse: collapse; margin: 12px 0 }}
td, th {{ border: 1px solid #c4ccd3; padding: 5px 9px; text-align: left }}
</style><div class="comment"><div class="by"><b>regress</b> commented on this pull request</div>
<div class="text">{text}</div></div>"""


def recorded() -> str:
    """Return the Markdown that the tutorial's last command printed."""
    cells = json.loads((DOCS / "tutorials" / "lander.ipynb").read_text(encoding="utf-8"))["cells"]
    printed = ["".join(one.get("text", "")) for cell in cells for one in cell.get("outputs", ())]
    (comment,) = (text.partition("\n###")[2] for text in printed if "\n###" in text)
    return f"###{comment}"


def main() -> None:
    """Let Chromium draw the comment, and cut off what is empty."""
    text = MarkdownIt("commonmark").enable("table").render(recorded())
    with tempfile.TemporaryDirectory() as folder:
        page, picture = Path(folder, "comment.html"), Path(folder, "comment.png")
        width = WIDTH - 2 * MARGIN
        page.write_text(PAGE.format(margin=MARGIN, width=width, text=text), encoding="utf-8")
        switches = ("--headless=new", "--no-sandbox", "--force-device-scale-factor=2")
        size = f"--window-size={WIDTH},1000"
        command = ["chromium", *switches, size, f"--screenshot={picture}", page.as_uri()]
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        drawn = Image.open(picture).convert("RGB")
    rows = np.flatnonzero((np.asarray(drawn) < 250).any(axis=(1, 2)))
    drawn.crop((0, 0, drawn.width, rows[-1] + 2 * MARGIN)).quantize(64).save(OUT, optimize=True)


if __name__ == "__main__":
    main()
