"""The site: its files, and how it works in headless Chromium."""

from __future__ import annotations

import functools
import http.server
import json
import re
import subprocess
import sys
import threading
import time
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag, urlsplit

import pytest
from made_board import CARDS, HOSTILE, RACING, Made, make_entries

import leaderboard.site
from leaderboard import board_tables
from leaderboard.site import MARK, build_site
from sada_gym.errors import FileError, MissingExtra, UserError

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def entries(tmp_path_factory):
    return make_entries(tmp_path_factory.mktemp("board") / "entries")


@pytest.fixture(scope="module")
def few_applications():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("leaderboard.board.cards", lambda: CARDS)
        yield


@pytest.fixture(scope="module")
def site(entries, few_applications):
    out = entries.parent / "site"
    build_site(entries, out, pictures=False)
    return out


class Page(HTMLParser):
    """What a page links to, its places, and the attributes that it has."""

    def __init__(self, text):
        super().__init__()
        self.links, self.ids, self.attributes, self.tags = [], set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        for name, value in attrs:
            self.attributes.append((tag, name, value))
            if name in ("href", "src"):
                self.links.append(value)
            if name == "id":
                self.ids.add(value)


@pytest.fixture(scope="module")
def pages(site):
    return {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}


def test_every_link_leads_somewhere(site, pages):
    assert len(pages) == 1 + 2 + 1 + 9
    checked = 0
    for path, page in pages.items():
        for link in page.links:
            if urlsplit(link).scheme:
                assert link in ("https://example.org/paper", "data:,")
                continue
            place, anchor = urldefrag(link)
            target = (path.parent / unquote(place)).resolve() if place else path
            assert target.is_file(), (path, link)
            assert target.is_relative_to(site)
            if anchor:
                assert anchor in pages[target].ids, (path, link)
            checked += 1
    assert checked > 200


def test_every_file_is_linked(site, pages):
    linked = {
        (path.parent / urldefrag(link)[0]).resolve()
        for path, page in pages.items()
        for link in page.links
        if not urlsplit(link).scheme
    }
    files = {path for path in site.rglob("*") if path.is_file() and path.name != MARK}
    assert files <= linked | set(pages)


def test_texts_of_entries_stay_texts(pages):
    for path, page in pages.items():
        text = path.read_text(encoding="utf-8")
        assert "<img src=x" not in text
        assert "</pre><script>" not in text
        assert "javascript:" not in text
        assert page.tags.count("script") == 2
        handlers = [name for _, name, _ in page.attributes if name.startswith("on")]
        assert handlers == []
    entry = next(path for path in pages if path.name == "strong.html")
    assert "&lt;img src=x onerror=alert(1)&gt;" in entry.read_text(encoding="utf-8")


def test_a_page_does_not_say_more_than_the_verifier_found(site):
    said = {
        name: (site / "entries" / f"{name}.html").read_text(encoding="utf-8")
        for name in ("weak", "newcomer")
    }
    assert "The verifier found nothing against these results." in said["weak"]
    assert "Not all of these results were verified yet" in said["newcomer"]
    assert "The verifier found nothing" not in said["newcomer"]


def test_the_policy_allows_nothing_from_elsewhere(pages):
    for page in pages.values():
        (policy,) = [
            v for t, n, v in page.attributes if t == "meta" and n == "content" and "src" in v
        ]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "http" not in policy
        assert not any(name == "style" for _, name, _ in page.attributes)
        assert "style" not in page.tags


def test_building_twice_gives_identical_bytes(entries, site, few_applications, tmp_path):
    build_site(entries, tmp_path / "again", pictures=False)

    def contents(folder):
        return {
            str(path.relative_to(folder)): path.read_bytes()
            for path in folder.rglob("*")
            if path.is_file()
        }

    assert contents(tmp_path / "again") == contents(site)


def test_another_folder_is_not_replaced(entries, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(UserError, match="to be empty or a site that was built before"):
        build_site(entries, tmp_path, pictures=False)
    with pytest.raises(UserError, match="to be empty or a site that was built before"):
        build_site(entries, tmp_path / "thesis.tex", pictures=False)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(FileError, match=r"Expected to read .*nowhere"):
        build_site(tmp_path / "nowhere", tmp_path / "out", pictures=False)


def test_no_entry_is_a_board_too(few_applications, tmp_path):
    (tmp_path / "entries").mkdir()
    out = tmp_path / "a" / "site"
    build_site(tmp_path / "entries", out)
    build_site(tmp_path / "entries", out)  # in place of the first one
    assert "No entry yet" in (out / "index.html").read_text(encoding="utf-8")
    assert not (out / "pictures").exists()


def test_each_step_is_told(entries, site, few_applications, tmp_path):
    told = []
    build_site(entries, tmp_path / "site", pictures=False, on_step=told.append)
    assert told[:2] == [f"reading the entries in {entries}", "ranking 9 entries"]
    pages = [step for step in told if step.startswith("the page of the entry")]
    assert len(pages) == 9
    assert pages[-1].endswith("9 of 9, and its pictures")
    assert re.fullmatch(r"writing \d+ files to .*", told[-1])


def test_the_citation_is_that_of_the_repository(site):
    text, index = (ROOT / "CITATION.cff").read_text(encoding="utf-8"), site / "index.html"
    shown = index.read_text(encoding="utf-8")
    for key in ("doi: ", "version: "):
        value = text.split(f"\n{key}" if key == "version: " else key)[1].split()[0]
        assert f"{{{value}}}" in shown


@pytest.mark.slow
def test_pictures_are_drawn_once(few_applications, tmp_path, monkeypatch):
    entries = make_entries(tmp_path / "entries", (Made("one", 0.5),))
    build_site(entries, tmp_path / "site")
    drawn = {path.name: path.read_bytes() for path in (tmp_path / "site" / "pictures").iterdir()}
    assert sorted(name.split(".", 1)[1] for name in drawn) == ["fooled.png", "marginals.png"]
    assert all(content.startswith(b"\x89PNG") for content in drawn.values())
    page = (tmp_path / "site" / "entries" / "one.html").read_text(encoding="utf-8")
    assert all(f"../pictures/{name}" in page for name in drawn)

    build_site(entries, tmp_path / "again")
    assert {p.name: p.read_bytes() for p in (tmp_path / "again" / "pictures").iterdir()} == drawn

    def refuse(*_):
        raise AssertionError("The picture was there.")

    monkeypatch.setattr("leaderboard.pictures.png", refuse)
    build_site(entries, tmp_path / "site")
    assert {p.name: p.read_bytes() for p in (tmp_path / "site" / "pictures").iterdir()} == drawn


@pytest.mark.slow
def test_the_command_builds_the_site(entries, tmp_path):
    command = [sys.executable, "-m", "leaderboard.site", "--no-pictures"]
    command += ["--entries", str(entries), "--out"]
    done = subprocess.run(
        [*command, str(tmp_path / "site")], cwd=ROOT, check=True, capture_output=True, text=True
    )
    assert "9 entries are on the board" in done.stdout
    assert re.search(r"^ *\d+:\d\d ranking 9 entries$", done.stderr, re.MULTILINE)
    (tmp_path / "mine").write_text("mine")
    refused = subprocess.run([*command, str(tmp_path)], cwd=ROOT, capture_output=True, text=True)
    assert refused.returncode == 2
    assert "Traceback" not in refused.stderr


SPAWNS = """
import multiprocessing, runpy, sys
if __name__ == "__main__":
    sys.path[0] = sys.argv[1]  # as of a script in that folder
    import site
    assert hasattr(site, "getsitepackages"), site
    process = multiprocessing.get_context("spawn").Process(target=print, args=("spawned",))
    process.start(); process.join()
    sys.exit(process.exitcode)
"""


def test_the_standard_librarys_site_is_not_hidden(tmp_path):
    script = ROOT / "leaderboard" / "submit.py"
    helped = subprocess.run([sys.executable, str(script), "--help"], capture_output=True, text=True)
    assert helped.returncode == 0, helped.stderr
    file = tmp_path / "spawns.py"
    file.write_text(SPAWNS)
    done = subprocess.run(
        [sys.executable, str(file), str(script.parent)], capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (0, "spawned\n"), done.stderr


def test_a_table_script_of_another_form_is_refused(monkeypatch):
    monkeypatch.setattr(leaderboard.site.importlib.metadata, "distribution", _other_distribution)
    with pytest.raises(
        UserError, match=r"Install the version of itables that constraints\.txt names"
    ):
        list(leaderboard.site.table_script())


def _other_distribution(name):
    class File(type(Path())):
        def read_text(self, encoding):
            return "export{a as b}"

    return type("Other", (), {"files": [File("itables/dt_bundle.js"), File("itables/LICENSE")]})


# ---- the browser


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.fixture(scope="module")
def address(site):
    handler = functools.partial(Quiet, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture
def view(browser, address):
    """Open pages; afterwards nothing was complained of and nothing was asked for elsewhere."""

    def opened(path, width=1400, scheme="light"):
        metrics = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        feature = {"name": "prefers-color-scheme", "value": scheme}
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
        browser.get(f"{address}/{path}")
        return browser

    yield opened
    assert browser.get_log("browser") == []
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [
        message["params"]["request"]["url"]
        for message in messages
        if message["method"] == "Network.requestWillBeSent"
    ]
    assert asked
    assert all(url.startswith((f"{address}/", "data:")) for url in asked), asked


ROWS = """
return [...document.querySelector("details.verified table.board").tBodies[0].rows]
    .map(row => [row.className.split(" ")[0], (row.querySelector("th") ?? row).textContent.trim()])
"""


def names(driver):
    return [name for _, name in driver.execute_script(ROWS)]


def head(driver, title):
    return driver.execute_script(
        """return [...document.querySelectorAll("details.verified table.board thead th")]
        .find(one => one.textContent.trim() === arguments[0])""",
        title,
    )


def eventually(get, wanted):
    """Wait for the table, which is drawn a moment after it was asked for."""
    end = time.monotonic() + 10
    while not wanted(get()) and time.monotonic() < end:
        time.sleep(0.02)
    assert wanted(get()), get()


def find(driver, selector):
    return driver.find_element("css selector", selector)


def test_a_column_sorts_by_click_and_by_key(view):
    driver = view("digits.html")
    before = names(driver)
    assert before[-1].startswith("uniform worlds")
    head(driver, "Runs").click()
    head(driver, "AFR, %").click()
    order = functools.partial(names, driver)
    eventually(order, lambda names: names[0] == HOSTILE)
    highest = order()
    find_order = "return arguments[0].getAttribute('aria-sort')"
    assert driver.execute_script(find_order, head(driver, "AFR, %")) == "descending"
    button = head(driver, "AFR, %").find_element("css selector", "[role=button]")
    driver.execute_script("arguments[0].focus()", button)
    driver.switch_to.active_element.send_keys("\ue007")  # Enter
    eventually(order, lambda names: names == highest[::-1])
    head(driver, "Rank").click()
    eventually(order, lambda names: set(names[:2]) == {HOSTILE, "=level"})
    assert {name.split()[0] for name in order()[-2:]} == {"uniform", "ideal"}  # no rank


def test_filters_leave_what_was_asked_for(view):
    driver = view("digits.html")
    everything = names(driver)
    search = find(driver, "details.verified input[type=search]")
    search.send_keys("midd")
    shown = functools.partial(names, driver)
    eventually(shown, lambda names: names == ["middle"])
    search.send_keys("x")
    body = find(driver, "details.verified table.board tbody")
    eventually(lambda: body.text, lambda text: text == "No row has this.")
    search.clear()
    search.send_keys(" ")
    eventually(shown, lambda names: names == everything)
    find(driver, "details.verified input[type=checkbox]").click()
    rows = functools.partial(driver.execute_script, ROWS)
    eventually(rows, lambda pairs: {kind for kind, _ in pairs} == {"ranked"})
    choose = "details.claimed select"
    find(driver, f"{choose} option[value=claimed]").click()
    claimed = functools.partial(driver.execute_script, ROWS.replace("verified", "claimed"))
    eventually(claimed, lambda pairs: [name for _, name in pairs] == ["newcomer"])


def test_the_pages_lead_to_each_other(view):
    driver = view("index.html")
    find(driver, ".cards a[href='digits.html']").click()
    assert find(driver, "h1").text == "Handwritten digits"
    link = next(
        link for link in driver.find_elements("css selector", ".name a") if link.text == HOSTILE
    )
    link.click()
    assert find(driver, "h1").text == HOSTILE
    find(driver, "header .brand").click()
    assert driver.current_url.endswith("/index.html")


def test_a_keyboard_user_skips_to_the_content_and_sees_the_focus(view):
    driver = view("digits.html")
    driver.switch_to.active_element.send_keys("\ue004")  # Tab
    skip = driver.switch_to.active_element
    assert skip.text == "Skip to the content"
    assert (
        driver.execute_script("return getComputedStyle(arguments[0]).outlineWidth", skip) == "3px"
    )
    skip.send_keys("\ue007")
    assert driver.switch_to.active_element.get_attribute("id") == "main"


@pytest.mark.parametrize(
    "path", ["index.html", "digits.html", "racing.html", "agents.html", "entries/strong.html"]
)
def test_a_phone_scrolls_tables_but_never_the_page(view, path):
    driver = view(path, width=390)
    assert driver.execute_script("return document.documentElement.scrollWidth") == 390
    table = find(driver, ".sheet .scroll")
    driver.execute_script("arguments[0].scrollLeft = 150", table)
    assert driver.execute_script("return arguments[0].scrollLeft", table) == 150
    name = find(driver, ".sheet tbody .name")
    box = "return arguments[0].getBoundingClientRect().left"
    beside = driver.execute_script(box, name) - driver.execute_script(box, table)
    assert 0 <= beside <= 2  # it stays


def test_a_dark_scheme_is_dark(view):
    def colours(scheme):
        driver = view("digits.html", scheme=scheme)
        script = """const style = getComputedStyle(document.body);
        return [style.backgroundColor, style.color].map(one => one.match(/\\d+/g).map(Number))"""
        return [sum(numbers) for numbers in driver.execute_script(script)]

    light_paper, light_ink = colours("light")
    dark_paper, dark_ink = colours("dark")
    assert light_paper > 700 > 150 > light_ink
    assert dark_ink > 600 > 150 > dark_paper


def test_tables_sort_in_a_page_from_a_folder_too(site, browser):
    browser.get((site / "digits.html").as_uri())
    assert find(browser, "details.verified input[type=search]").is_displayed()
    assert browser.get_log("browser") == []


def test_a_part_that_is_missing_stops_no_page(entries, few_applications, tmp_path, monkeypatch):
    known = board_tables.current_target

    def lacking(track, agent):
        if track in RACING:
            raise MissingExtra("Expected PyBullet, got none.")
        return known(track, agent)

    monkeypatch.setattr(board_tables, "current_target", lacking)
    board_tables.missing_part.cache_clear()
    try:
        board = build_site(entries, tmp_path / "site", pictures=False)
    finally:
        board_tables.missing_part.cache_clear()
    page = (tmp_path / "site" / "racing.html").read_text(encoding="utf-8")
    assert page.count("was not checked. Expected PyBullet, got none.") == 1
    racing = next(group for group in board.groups if group.card.page == "racing")
    assert [entry.metadata.name for entry in racing.entries] == ["racer"]
    assert "uniform worlds" in page  # the entry tells their rate
    digits = (tmp_path / "site" / "digits.html").read_text(encoding="utf-8")
    assert "was not checked" not in digits
