"""`sada-gym replay`."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from PIL import Image
from typer.testing import CliRunner

from sada_gym.cli import app

CART = """
environment = "CartPole-v1"
agent = "pole_agent:right"
agent_id = "always right"
score = ["length", 100]
fooling_threshold = 0.5
[parameters]
length = { kind = "attribute", low = 0.25, high = 2.0, unit = "m" }
"""


def run(*args: str | Path):
    return CliRunner().invoke(app, [*map(str, args)])


@pytest.fixture(scope="module")
def digits(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "digits"
    words = "attack SADA-Digits-3-v0 -a random --budget 0 --samples 20 --workers 1 --out"
    assert run(*words.split(), folder).exit_code == 0
    return folder


def test_a_video_is_written_and_summed_up(digits, tmp_path):
    out = tmp_path / "video.gif"
    result = run("replay", digits, "--out", out, "--worst", "2", "--seconds", "2")
    assert result.exit_code == 0, result.output
    assert "Replaying sample 2 of 2" in result.stderr  # stdout is the summary alone
    assert result.stdout.count("a 3, taken for a") == 2
    assert f"{out}: 7.0 s" in result.stdout
    with Image.open(out) as video:
        assert video.is_animated
        assert video.info["loop"] == 0


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["{run}", "--out", "video.avi"], "Expected a file that ends in .gif or .mp4"),
        (["{run}", "--out", "none/video.gif"], "its folder does not exist"),
        (["{run}", "--out", "x.gif", "--sample", "20"], "Expected sample of at most 19, got 20"),
        (["{run}", "--out", "x.gif", "--sample", "-1"], "Expected sample of at least 0, got -1"),
        (["{run}", "--out", "x.gif", "--worst", "0"], "Expected worst of at least 1, got 0"),
        (["{run}", "--out", "x.gif", "--worst", "2", "--sample", "1"], "got both"),
        (["{run}", "--out", "x.gif", "--seconds", "0"], "Expected seconds from 1 to 60, got 0"),
        (["{run}", "--out", "x.gif", "--seconds", "nan"], "Expected seconds from 1 to 60, got nan"),
        (["{run}", "--out", "x.gif", "--worst", "7"], "7 samples of 10 s. Take --seconds 8"),
        (["nowhere", "--out", "x.gif"], "Expected a folder that `sada-gym attack` wrote"),
        (["{run}", "--out", "x.gif", "--application", "no.toml"], "no.toml"),
        (["{run}", "--out", "x.gif", "--application", "CartPole-v1"], "CartPole-v1"),
        (["{run}"], "--out"),
    ],
)
def test_bad_input_gets_a_sentence(digits, args, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("replay", *(word.format(run=digits) for word in args))
    assert result.exit_code == 2
    assert message in result.stderr
    assert "Traceback" not in result.output
    assert list(tmp_path.iterdir()) == []


def test_a_toml_file_is_named(tmp_path, monkeypatch):
    (tmp_path / "cart.toml").write_text(CART)
    (tmp_path / "pole_agent.py").write_text("def right(state):\n    return 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    words = "attack cart.toml -a random --budget 0 --samples 4 --workers 1 --out run"
    assert run(*words.split()).exit_code == 0
    assert run("replay", "run", "--out", "remembered.gif").exit_code == 0
    (tmp_path / "cart.toml").rename(tmp_path / "moved.toml")
    assert run("replay", "run", "--out", "video.gif").exit_code == 0  # by the text that is recorded
    (tmp_path / "pole_agent.py").unlink()
    sys.modules.pop("pole_agent")
    refused = run("replay", "run", "--out", "video.gif")
    assert refused.exit_code == 2
    assert "name that by --application FILE.toml" in refused.stderr
    (tmp_path / "pole_agent.py").write_text("def right(state):\n    return 1\n")
    result = run("replay", "run", "--out", "video.gif", "--application", "moved.toml")
    assert result.exit_code == 0, result.output
    assert "steps" in result.stdout
    assert (tmp_path / "video.gif").stat().st_size > 1_000
