"""The report in headless Chromium: what the program on the page does, and how it looks."""

import json

import numpy as np
import pytest
from hostile_worlds import Hostile
from PIL import Image
from toy import Greedy

from sada_gym import attack
from sada_gym.analyses.report.make import report


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser")
    return [
        attack(Hostile(), Greedy, out=folder / name, budget=100, seed=seed, progress=False)
        for name, seed in (("a <b> 'c'", 1), ("other", 2))
    ]


@pytest.fixture
def view(browser):
    """Open a file; afterwards nothing was complained of and nothing was asked for elsewhere."""

    def opened(path, width=1400, scheme="light", scripts=True):
        metrics = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        feature = {"name": "prefers-color-scheme", "value": scheme}
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": not scripts})
        browser.get(path.as_uri())
        return browser

    yield opened
    assert browser.get_log("browser") == []
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    sent = [one["params"] for one in messages if one["method"] == "Network.requestWillBeSent"]
    assert sent
    assert all(one["request"]["url"].startswith(("file:", "data:")) for one in sent)
    assert {one["request"]["url"] for one in sent if one["type"] != "Document"} <= {
        one["request"]["url"] for one in sent if one["request"]["url"].startswith("data:")
    }


def find(driver, selector):
    return driver.find_element("css selector", selector)


def counted(driver):
    return find(driver, ".chosen output").text


def press(driver, *keys):
    for key in keys:
        driver.switch_to.active_element.send_keys(key)


@pytest.mark.parametrize("width", [390, 1400])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_and_is_drawn(view, runs, width, scheme):
    driver = view(runs[0].html, width, scheme)
    assert driver.execute_script("return document.documentElement.scrollWidth") <= width
    assert find(driver, "h1").is_displayed()
    colours = driver.execute_script(
        """const canvas = document.querySelector("canvas");
        const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
        const found = new Set();
        for (let i = 0; i < data.length; i += 4) found.add(`${data[i]},${data[i+1]},${data[i+2]}`);
        return [found.size, getComputedStyle(document.body).backgroundColor]"""
    )
    assert colours[0] > 20
    assert (colours[1] == "rgb(251, 250, 248)") == (scheme == "light")


def test_without_a_program_the_first_screen_stands(view, runs):
    driver = view(runs[0].html, scripts=False)
    assert "This part needs JavaScript" in find(driver, "noscript").text
    assert f"{100 * runs[0].result.afr:.0f} %" in find(driver, ".rates").text
    assert find(driver, ".pictures img").is_displayed()
    assert not find(driver, ".controls").is_displayed()


def test_filters_count_worlds(view, runs):
    (result,) = runs[:1]
    driver = view(result.html)
    asked, fooled = result.queries.fooled(0.3), result.samples.fooled(0.3)
    of_queries = f"{asked.sum()} of {len(asked)} training queries selected fail."
    assert counted(driver) == f"{fooled.sum()} of 40 test samples and {of_queries}"
    find(driver, "[name=queries]").click()
    assert counted(driver) == f"{fooled.sum()} of 40 test samples selected fail."
    find(driver, "[name=passes]").click()
    assert counted(driver).startswith(f"{fooled.sum()} of {fooled.sum()} ")
    find(driver, "[name=passes]").click()
    find(driver, "[name=y-to]").send_keys("0.1")
    low = (result.samples.score <= 0.1).sum()
    assert counted(driver).startswith(f"{low} of {low} ")
    rows = driver.find_elements("css selector", "tbody button")
    assert len([row for row in rows if row.text.startswith("sample")]) == min(20, low)


def test_a_box_chooses_worlds_and_escape_gives_them_up(view, runs):
    from selenium.webdriver import ActionChains

    (result,) = runs[:1]
    driver = view(result.html)
    before = counted(driver)
    canvas = find(driver, "canvas")
    driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", canvas)
    width, height = canvas.size["width"], canvas.size["height"]
    chain = ActionChains(driver, duration=20)
    chain.move_to_element_with_offset(canvas, 60 - width / 2, height * 0.45 - height / 2)
    chain.click_and_hold().move_by_offset(width - 80, height * 0.4).release().perform()
    chosen = counted(driver)
    assert chosen != before
    totals = [int(part.split()[0]) for part in chosen.split(" of ")[1:]]
    assert 0 < sum(totals) < 140
    driver.execute_script("arguments[0].focus()", canvas)
    press(driver, "\ue00c")
    assert counted(driver) == before


def test_the_keyboard_reaches_a_world_and_its_values(view, runs):
    (result,) = runs[:1]
    driver = view(result.html)
    driver.execute_script("document.querySelector('canvas').focus()")
    press(driver, "\ue014", "\ue014", "\ue012", "\ue007")
    panel = find(driver, ".world")
    told = panel.text
    lines = [one.text for one in panel.find_elements("css selector", "pre")]
    mu_line = next(line for line in lines if line.startswith("mu, seed = "))
    mu, seed = eval(mu_line.removeprefix("mu, seed = "))  # as a user would
    both = result.samples + result.queries
    (row,) = np.flatnonzero((both.mu == np.array(mu, np.float32)).all(axis=1))
    assert both.seed[row] == seed
    assert f"Q = {both.score[row]:.3f}" in told
    values = json.loads(lines[0])
    physical = dict(zip(Hostile.parameters.names, Hostile.parameters.physical(mu), strict=True))
    names = [*physical]
    assert values[names[0]] == physical[names[0]]
    assert values[names[1]] == pytest.approx(physical[names[1]], rel=1e-12)
    assert values["kind"] in Hostile.parameters.parameters[2].choices
    assert values["count"] in (1, 2, 3, 4)


def test_a_row_of_the_table_shows_its_world_and_command(view, runs):
    driver = view(runs[0].html)
    find(driver, "[name=queries]").click()
    button = find(driver, "tbody button")
    name = button.text
    button.click()
    panel = find(driver, ".world")
    assert panel.find_element("css selector", "h3").text.lower().startswith(name)
    shown = len(panel.find_elements("css selector", "tbody th"))
    assert shown == len(Hostile.parameters)  # its own values, not the table's rows
    assert len(driver.find_elements("css selector", ".scroll tbody tr")) > 1
    commands = [one.text for one in panel.find_elements("css selector", "pre")]
    row = name.removeprefix("sample ")
    assert f"""sada-gym replay 'a <b> '"'"'c'"'"'' --sample {row} --out replay.gif""" in commands


@pytest.mark.long
def test_two_runs_share_a_choice(view, runs, tmp_path):
    path = report(*(result.folder for result in runs), out=tmp_path / "two.html")
    driver = view(path)
    assert len(driver.find_elements("css selector", "canvas")) == 2
    find(driver, "[name=y-to]").send_keys("0.3")
    counts = [one.samples.fooled(0.3).sum() for one in runs]
    for letter, count in zip("AB", counts, strict=True):
        assert f"{letter}: {count} of {count} test samples" in counted(driver)
    driver = view(path, 390, "dark")
    assert driver.execute_script("return document.documentElement.scrollWidth") <= 390


def test_the_first_screen_is_a_picture(view, runs, tmp_path):
    view(runs[0].html)
    path = report(runs[0].folder, out=tmp_path / "top.png")
    with Image.open(path) as picture:
        assert picture.size == (1400, 900)
        assert len(picture.convert("RGB").getcolors(1_000_000)) > 100
