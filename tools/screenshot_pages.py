"""Look at the built pages on a phone and on a desk, light and dark.

    python -m tools.screenshot_pages docs/_build/html FOLDER [page ...]

It takes a picture of each page, or of those named (such as `environments/uav`), into FOLDER. It
fails if a page is wider than the screen, if an image or a name in a table is broken, or if the
console holds an error. It needs selenium, chromium and chromedriver.
"""

from __future__ import annotations

import shutil
import sys
from base64 import b64decode
from pathlib import Path

from selenium import webdriver

WIDTHS, THEMES, LONGEST = (390, 1400), ("light", "dark"), 16_000
"""Pixels; a picture ends after `LONGEST`, since Chromium draws no larger ones."""

TOO_WIDE = """
const width = document.documentElement.clientWidth
const frames = ".table-wrapper, pre, .math-wrapper, .sidebar-drawer, .toc-drawer, .scroll, .top nav"
const scrolls = one => one.closest(frames)
return [...document.querySelectorAll("body *")]
    .filter(one => one.getBoundingClientRect().right > width + 1 && !scrolls(one)
        && getComputedStyle(one).position !== "fixed")
    .map(one => one.tagName.toLowerCase() + ": " + one.textContent.trim().slice(0, 40))
"""

BROKEN_IMAGES = """
return [...document.images].filter(one => !one.complete || one.naturalWidth === 0)
    .map(one => "broken image: " + one.getAttribute("src"))
"""

BROKEN_NAMES = """
const height = one => one.getBoundingClientRect().height
const line = one => parseFloat(getComputedStyle(one).lineHeight)
const isName = text => /^[\\w.-]{2,40}$/.test(text)
return [...document.querySelectorAll("td code .pre")]
    .filter(one => isName(one.textContent) && height(one) > 1.6 * line(one))
    .map(one => "broken name: " + one.textContent)
"""


def open_browser() -> webdriver.Chrome:
    """Start Chromium without a window."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for switch in ("headless=new", "no-sandbox", "disable-dev-shm-usage", "hide-scrollbars"):
        options.add_argument(f"--{switch}")
    options.set_capability("goog:loggingPrefs", {"browser": "SEVERE"})
    service = webdriver.ChromeService(shutil.which("chromedriver"))
    return webdriver.Chrome(options=options, service=service)


def screenshot(
    browser: webdriver.Chrome, page: Path, width: int, theme: str
) -> tuple[bytes, list[str]]:
    """Return a page's picture, as PNG, and its faults in words."""
    metrics = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    feature = {"name": "prefers-color-scheme", "value": theme}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    browser.get(page.resolve().as_uri())
    height = browser.execute_script("return document.documentElement.scrollHeight")
    clip = {"x": 0, "y": 0, "width": width, "height": min(height, LONGEST), "scale": 1}
    shot = browser.execute_cdp_cmd(
        "Page.captureScreenshot", {"captureBeyondViewport": True, "clip": clip}
    )
    scripts = (TOO_WIDE, BROKEN_IMAGES, BROKEN_NAMES)
    faults = [fault for script in scripts for fault in browser.execute_script(script)]
    faults += [entry["message"] for entry in browser.get_log("browser")]
    return b64decode(shot["data"]), faults


def main(root: Path, out: Path, names: list[str]) -> int:
    """Look at all pages; 1 if one has a fault."""
    out.mkdir(parents=True, exist_ok=True)
    pages = [path.relative_to(root).with_suffix("") for path in sorted(root.rglob("*.html"))]
    browser, bad = open_browser(), 0
    for page in map(Path, names) if names else pages:
        for width in WIDTHS:
            for theme in THEMES:
                picture, faults = screenshot(browser, root / f"{page}.html", width, theme)
                (out / f"{'-'.join(page.parts)}-{width}-{theme}.png").write_bytes(picture)
                if faults:
                    bad = 1
                    print(f"{page}, {width} pixels, {theme}: {faults[:3]}")
    browser.quit()
    return bad


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]))
