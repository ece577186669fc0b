"""report.html: what stands in it, and what runs it can be made of."""

import base64
import dataclasses
import html.parser
import io
import json
import re
import shutil
from datetime import date

import numpy as np
import pytest
from hostile_worlds import TAG, Hostile
from PIL import Image
from typer.testing import CliRunner

from sada_gym import Application, Parameter, ParameterSpace, attack
from sada_gym.analyses.report import page as pages
from sada_gym.analyses.report.make import report
from sada_gym.analyses.report.page import page
from sada_gym.analyses.report.read import read_view
from sada_gym.analyses.report.thumbnails import THUMBNAILS_FILE
from sada_gym.analyses.report.views import ReportPicture
from sada_gym.application import Scored
from sada_gym.cli import app
from sada_gym.errors import FileError, UserError
from sada_gym.foundations.frames import Take
from sada_gym.measures.diagnosis.record import (
    Condition,
    Diagnosis,
    Example,
    Rate,
    Weakness,
    write_diagnosis,
)


class Page(html.parser.HTMLParser):
    """The tags, texts and scripts of a page."""

    def __init__(self, content):
        super().__init__()
        self.tags, self.scripts, self.words, self._in_script = [], [], [], False
        self.feed(content.decode())

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self._in_script = tag in ("script", "style")
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag):
        self._in_script = False

    def handle_data(self, data):
        if not self._in_script:
            self.words.append(data)
        elif self.tags[-1][0] == "script":
            self.scripts[-1] += data

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())

    @property
    def data(self):
        return json.loads(self.scripts[0])

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


def run(folder, environment="SADA-Digits-3-v0", adversary="level-set", **keywords):
    given = {"budget": 200, "samples": 40, "progress": False, **keywords}
    return attack(environment, adversary, out=folder, **given)


@pytest.fixture(scope="module")
def digits(tmp_path_factory):
    return run(tmp_path_factory.mktemp("report") / "digits")


@pytest.fixture
def copied(digits, tmp_path):
    return shutil.copytree(digits.folder, tmp_path / "digits")


@pytest.mark.long
def test_the_first_screen_needs_no_program(digits):
    shown = Page(digits.html.read_bytes())
    before = shown.text.partition("Browse the worlds")[0]
    assert "Handwritten digits: where cnn fails" in before
    assert f"{100 * digits.result.afr:.0f} %" in before
    assert "all worlds in the ranges" in before
    assert f"{date.today():%B %Y}" in before
    assert "sada-gym replay digits --out failure.gif" in before
    assert " ".join(digits.diagnosis.sentence.split()) in before
    images = shown.all("img")
    assert all(one["src"].startswith("data:image/") for one in images)
    pictures = [one for one in images if "data-plot" not in one]
    assert pictures
    assert len(images) == len(pictures) + 1, "the map of the two parameters that matter most"
    assert all("rotation" in one["alt"] and "Q = " in one["alt"] for one in pictures)
    verdicts = {one["alt"].partition(":")[0] for one in pictures}
    assert verdicts == {"Fails", "Passes"}, "beside failures stands what passes"
    (plot,) = (one["src"].split(",")[1] for one in images if "data-plot" in one)
    assert b"@media(prefers-color-scheme:dark)" in base64.b64decode(plot)
    for word in ("novelty", "mu_std", "of 200 queries"):
        assert word not in shown.text


def test_the_page_asks_for_nothing_and_runs_nothing_but_its_own(digits):
    content = digits.html.read_bytes()
    assert len(content) < 1_000_000
    shown = Page(content)
    (policy,) = (one["content"] for one in shown.all("meta") if "http-equiv" in one)
    assert policy.startswith("default-src 'none'; img-src data:; style-src 'sha256-")
    assert "unsafe" not in policy
    assert not re.search(r'(?:href|src)="(?!data:|#)', content.decode())
    assert not any("style" in attributes for _, attributes in shown.tags)
    assert len(shown.scripts) == 2


def test_the_data_holds_every_world(digits):
    (plotted,) = Page(digits.html.read_bytes()).data
    assert plotted["samples"] == 40
    assert plotted["left_out"] == 0
    mu = np.frombuffer(base64.b64decode(plotted["mu"]), "<f4").reshape(-1, 6)
    np.testing.assert_array_equal(mu, (digits.samples + digits.queries).mu)
    assert plotted["replay"] == "sada-gym replay digits"
    assert plotted["pictures"]


@pytest.mark.long
def test_the_same_run_gives_the_same_bytes(digits, copied, tmp_path):
    assert report(copied).read_bytes() == digits.html.read_bytes()
    again = run(tmp_path / "again" / "digits")
    shutil.copystat(digits.folder / "attack.json", again.folder / "attack.json")  # its day
    report(again.folder)
    assert again.html.read_bytes() == digits.html.read_bytes()
    assert (again.folder / THUMBNAILS_FILE).read_bytes() == (
        digits.folder / THUMBNAILS_FILE
    ).read_bytes()


def test_commands_on_a_page_find_a_run_in_a_folder_below(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = run("runs/digits")
    page = Page(made.html.read_bytes())
    assert re.search(r"sada-gym \w+ runs/digits --", page.text)
    assert page.data[0]["replay"] == "sada-gym replay runs/digits"


def test_a_report_that_is_missing_comes_back_with_resume(digits, copied):
    (copied / "report.html").unlink()
    assert run(copied, resume=True).html.read_bytes() == digits.html.read_bytes()


def test_a_later_diagnosis_or_confirmation_makes_the_report_anew(copied, tmp_path):
    resumed = shutil.copytree(copied, tmp_path / "resumed")
    command = ["diagnose", str(copied), "--confirm", "1", "--fresh", "20"]
    assert CliRunner().invoke(app, command).exit_code == 0
    shown = Page((copied / "report.html").read_bytes())
    assert " fail again on a fresh seed" not in shown.text
    assert "failures that repeat" in shown.text
    assert run(resumed, resume=True, confirm=1).html is not None
    assert "failures that repeat" in Page((resumed / "report.html").read_bytes()).text


def test_a_report_can_be_left_out(tmp_path):
    left_out = run(tmp_path / "run", adversary="random", budget=0, html=False)
    assert left_out.html is None
    assert not (tmp_path / "run" / "report.html").exists()


@pytest.mark.parametrize("missing", ["worlds.json", "thumbnails.zip", "run.sqlite", "result.json"])
def test_a_run_of_another_version_lacks_some_files(digits, copied, missing):
    (copied / missing).unlink()
    content = report(copied).read_bytes()
    if missing in ("worlds.json", "thumbnails.zip"):
        assert len(Page(content).all("img")) == len(Page(digits.html.read_bytes()).all("img"))
        assert (copied / missing).exists()
    else:
        assert missing in Page(content).text
        assert f"{100 * digits.result.afr:.0f} %" in Page(content).text


@pytest.mark.parametrize("damaged", ["worlds.json", "thumbnails.zip", "result.json"])
def test_a_damaged_file_is_told_or_made_anew(digits, copied, damaged):
    (copied / damaged).write_bytes((copied / damaged).read_bytes()[:100])
    shown = Page(report(copied).read_bytes())
    assert f"{100 * digits.result.afr:.0f} %" in shown.text


def test_more_pictures_are_drawn_and_kept(digits, copied):
    before = len(Page(digits.html.read_bytes()).data[0]["pictures"])
    told = []
    content = report(copied, pictures=40, on_progress=lambda *counts: told.append(counts))
    assert len(Page(content.read_bytes()).data[0]["pictures"]) == 40 > before
    assert told[-1][0] == told[-1][1] == len(told)
    told.clear()
    report(copied, pictures=40, on_progress=lambda *counts: told.append(counts))
    assert not told


def hostile_run(folder):
    return attack(Hostile(), "random", out=folder, budget=30, seed=2, progress=False)


def test_names_are_texts(tmp_path):
    result = hostile_run(tmp_path / "a <b> 'c'")
    content = result.html.read_bytes()
    shown = Page(content)
    assert len(shown.scripts) == 2
    assert shown.data[0]["parameters"][0]["name"] == TAG
    assert shown.data[0]["replay"] == """sada-gym replay 'a <b> '"'"'c'"'"''"""
    assert TAG in shown.text
    assert "<b>bold</b>" in shown.text
    assert b"<b>bold" not in content
    assert all(one["src"].startswith("data:") for one in shown.all("img"))


def test_an_application_made_in_python_needs_no_opening(tmp_path):
    result = hostile_run(tmp_path / "run")
    first = result.html.read_bytes()
    assert report(result.folder).read_bytes() == first
    assert "attack(application, 'random'" in Page(first).text
    (result.folder / "worlds.json").unlink()
    shown = Page(report(result.folder).read_bytes())
    assert "Parameters have no names and units" in shown.text
    assert [one["name"] for one in shown.data[0]["parameters"]][:2] == ["mu 1", "mu 2"]
    assert report(result.folder, application=Hostile()).read_bytes() == first
    with pytest.raises(UserError, match="Expected to open"):
        report(result.folder, application="SADA-Analytic-v0")


class Plain(Application):
    """An application without pictures."""

    name, fooling_threshold, sample_size = "Plain", 0.3, 20

    def __init__(self, dimension, q=None):
        self.parameters = ParameterSpace(*(Parameter(f"p{i}", 0, 1) for i in range(dimension)))
        self.q = q

    @property
    def settings(self):
        return {"dimension": len(self.parameters), "q": self.q}

    def evaluate_batch(self, mu, seeds):
        score = (mu[:, 0].astype(float) + 1) / 2 if self.q is None else np.full(len(mu), self.q)
        return Scored(score, [{} for _ in mu])


@pytest.mark.parametrize(("dimension", "q"), [(1, None), (64, None), (2, 1.0), (2, 0.0)])
def test_runs_of_any_size_with_and_without_failures(tmp_path, dimension, q):
    result = run(tmp_path / "run", Plain(dimension, q), "random", budget=40)
    shown = Page(result.html.read_bytes())
    assert not shown.all("img")
    assert f"{100 * result.result.afr:.0f} %" in shown.text
    assert len(shown.data[0]["parameters"]) == dimension
    if q == 1.0:
        assert "No world fooled the agent." in shown.text


def test_of_very_many_worlds_some_are_plotted(digits, monkeypatch):
    monkeypatch.setattr(pages, "MOST_WORLDS", 50)
    shown = Page(page(read_view(digits)))
    assert shown.data[0]["samples"] == 40
    assert shown.data[0]["left_out"] == 190
    assert "190 worlds are not plotted" in shown.text


def weakness(samples, row):
    mu = samples.mu[row]
    example = Example(
        mu=tuple(mu.tolist()), seed=int(samples.seed[row]), score=0.1, parameters={"scale": 1.0}
    )
    condition = Condition(parameter="scale", ranges=((0.0, 1.0),), text="scale is below 1")
    return Weakness(
        conditions=(condition,),
        text="scale is below 1",
        volume=0.25,
        share=0.6,
        failures=30,
        distinct=2,
        inside=Rate.of(40, 50),
        outside=Rate.of(3, 50),
        thresholds=(),
        examples=(example,),
        behaviour="taken for a 4 in 7 of 10",
    )


def test_a_diagnosis_takes_the_place_of_the_sentence(digits, copied):
    row = int(np.flatnonzero(digits.samples.fooled(0.5))[0])
    diagnosis = Diagnosis(
        sentence="Two weaknesses.",
        weaknesses=(weakness(digits.samples, row),),
        worlds=240,
        failures=50,
    )
    write_diagnosis(copied, diagnosis)
    shown = Page(report(copied).read_bytes())
    first = shown.text.partition("Browse the worlds")[0]
    assert "Two weaknesses." in first
    assert "Scale is below 1" in first
    assert "80 % (67 to 89) fail, 6 % (2 to 16) elsewhere" in first
    assert "60 % of all failures; taken for a 4 in 7 of 10" in first
    assert f"Fails: sample {row}, Q = 0.10" in first
    assert first.count("cale is below 1") == 1, "each fact stands once"
    failure, passing, chances = (image["alt"] for image in shown.all("img"))
    assert failure.startswith(f"Fails: sample {row}, Q = 0.10")
    assert passing.startswith("Passes: ")
    assert chances.startswith("The chance of failing")
    assert shown.data[0]["weaknesses"] == ["Scale is below 1"]
    (copied / "diagnosis.json").write_text("{}")
    assert "diagnosis.json is damaged" in Page(report(copied).read_bytes()).text


@pytest.mark.long
@pytest.mark.parametrize("runs", [1, 2])
def test_a_page_with_as_many_pictures_as_can_be_is_below_10_mb(digits, runs):
    found = read_view(digits)
    large = {key: b"RIFF    WEBP" + bytes(250_000) for key in found.pictures}
    large |= {f"{i:016x}": bytes(250_000) for i in range(40 - len(large))}
    found = dataclasses.replace(found, pictures=large)
    content = page(*[found] * runs)
    assert 1_000_000 < len(content) < 10_000_000


def test_a_caption_has_room_for_the_beginning_of_what_the_agent_did():
    told = "left its lane; " * 40
    picture = ReportPicture("key", "data:,", "Q = 0.10", ("scale 1",), told)
    assert len(picture.brief) <= 110
    assert picture.brief.endswith(" …")
    assert ReportPicture("key", "data:,", "Q = 0.10", ("scale 1",), "").brief == ""


def test_two_agents_are_compared_in_the_worlds_that_both_runs_have(tmp_path):
    runs = [run(tmp_path / name, Plain(2, q), budget=60) for name, q in (("a", None), ("b", 0.0))]
    path = report(*(one.folder for one in runs))
    assert path == tmp_path / "a" / "report-b.html"
    shown = Page(path.read_bytes())
    assert [one["name"] for one in shown.data] == ["A: a", "B: b"]
    ours, theirs = (
        {mu.tobytes(): fooled for mu, fooled in zip(worlds.mu, worlds.fooled(0.3), strict=True)}
        for worlds in (one.queries for one in runs)
    )
    common = ours.keys() & theirs.keys()
    both = sum(ours[key] for key in common)
    assert len(common) > both > 0, "both begin with the same uniform queries"
    share = f"{100 * both / len(common):.0f} %"
    where = f"of the {len(common)} worlds that both runs evaluated"
    assert f"A fails in {share} {where}, B in 100 %: a difference of " in shown.text
    assert "so B fails more often." in shown.text
    assert "experiment.target.application.settings.q None 0.0" in shown.text
    with pytest.raises(UserError, match="Expected two runs"):
        report(runs[0].folder, runs[0].folder)


def test_runs_with_other_parameters_are_shown_but_not_paired(digits, tmp_path):
    other = run(tmp_path / "other", Plain(2), "random", budget=0)
    shown = Page(report(digits.folder, other.folder, out=tmp_path / "two.html").read_bytes())
    assert "of the worlds that its adversary makes, B in " in shown.text
    assert [len(one["parameters"]) for one in shown.data] == [6, 2]


def test_the_command_tells_its_page(digits, copied, tmp_path):
    out = tmp_path / "page.html"
    shown = CliRunner().invoke(app, ["report", str(copied), "--out", str(out), "--json"])
    assert shown.exit_code == 0, shown.output
    assert json.loads(shown.stdout) == {"path": str(out), "size": out.stat().st_size}
    assert out.read_bytes() == digits.html.read_bytes()
    missing = CliRunner().invoke(app, ["report", str(tmp_path)])
    assert missing.exit_code == 2
    assert "holds no attack.json" in missing.stderr


def test_a_png_needs_a_browser(digits, copied, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    shown = CliRunner().invoke(app, ["report", str(copied), "--out", str(copied / "top.png")])
    assert shown.exit_code == 2
    assert "Install Chromium" in " ".join(shown.stderr.split())
    assert not (copied / "top.png").exists()


class Walk(Plain):
    """An application whose episodes have five frames."""

    def render(self, mu, seed):
        return np.full((8, 12, 3), 200, np.uint8)

    def takes(self, mu, seed):
        draw = lambda step: (np.full((8, 12, 3), 40 * step, np.uint8), "")  # noqa: E731
        return [Take(5, draw, "fell", failed=True)], 0.0


def test_an_episode_is_a_film_strip_beside_one_that_passes(tmp_path):
    result = run(tmp_path / "run", Walk(2), "random", budget=40)
    shown = Page(result.html.read_bytes())
    strips = [one for one in shown.all("img") if "Q = " in one["alt"]]
    assert [one["alt"].partition(":")[0] for one in strips[:2]] == ["Fails", "Passes"]
    with Image.open(io.BytesIO(base64.b64decode(strips[0]["src"].split(",")[1]))) as strip:
        assert strip.size == (5 * 12 + 4, 8)
    first = result.html.read_bytes()
    told = []
    kept = report(result.folder, application=Walk(2), on_progress=lambda *one: told.append(one))
    assert (kept.read_bytes(), told) == (first, []), "they are kept"


def test_an_interrupted_report_leaves_the_old_one(digits, copied, monkeypatch):
    monkeypatch.setattr("sada_gym.analyses.report.make.page", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        report(copied)
    assert (copied / "report.html").read_bytes() == digits.html.read_bytes()
    with pytest.raises(FileError):
        report(copied / "nowhere")


def test_drawing_that_fails_costs_pictures_alone(tmp_path):
    class Breaking(Hostile):
        def render(self, mu, seed):
            raise RuntimeError("no display")

    with pytest.warns(UserWarning, match="no display"):
        result = attack(Breaking(), "random", out=tmp_path / "run", budget=30, progress=False)
    shown = Page(result.html.read_bytes())
    assert not shown.all("img")
