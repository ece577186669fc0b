"""Ids whose detector and models have to be installed first: there, and missing."""

import numpy as np
import pytest
from typer.testing import CliRunner

from sada_gym.cli import app
from sada_gym.errors import FileError
from sada_gym.evaluation.problems import make_application
from sada_gym.foundations.cards import find_card
from sada_gym.foundations.registration import env_ids, tracks

CARD = find_card("SADA-DetectionCoco")
CAR = "SADA-DetectionCoco-Car-v0"


@pytest.fixture
def nothing_installed(tmp_path, monkeypatch):
    monkeypatch.setenv("SADA_GYM_DATA", str(tmp_path))
    monkeypatch.setenv("SADA_GYM_MODELS", str(tmp_path))


def run(*args):
    return CliRunner().invoke(app, [*map(str, args)], env={"COLUMNS": "200"})


def test_what_is_missing_is_named_with_the_line_that_installs_it(nothing_installed):
    for line in ("`sada-gym fetch coco-centernet`", "`sudo apt install sweethome3d-furniture`"):
        assert line in CARD.missing
    assert CAR in env_ids()
    assert CAR in tracks()
    assert CAR not in tracks(installed=True)
    assert "SADA-Detection-Car-v0" in tracks(installed=True)
    with pytest.raises(FileError, match="apt install sweethome3d-furniture"):
        make_application(CAR)
    listed = run("envs")
    assert listed.exit_code == 0
    assert "SADA-DetectionCoco: Expected coco-centernet" in listed.stdout


@pytest.mark.parametrize(
    "args",
    [
        ["attack", CAR, "-a", "random", "--budget", "0", "--out"],
        ["benchmark", "--suite", "detection-coco", "--out"],
    ],
)
def test_a_run_without_the_parts_is_refused_and_leaves_nothing(nothing_installed, tmp_path, args):
    refused = run(*args, tmp_path / "run")
    assert refused.exit_code == 2, refused.output
    assert "Install it by `sudo apt install" in refused.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.skipif(bool(CARD.missing), reason=CARD.missing)
@pytest.mark.parametrize("track", CARD.track_ids)
def test_every_track_shows_its_models_to_the_detector(track):
    application = make_application(track)
    assert application.agent_name == "coco-centernet"
    settings = application.settings
    assert (settings["shapes"], settings["image_size"]) == ("textured", 320)
    assert [shape.name for shape in application.shapes] == settings["only"]
    if track == CAR:
        mu = np.zeros((2, len(application.parameters)), np.float32)
        infos = application.evaluate(mu, [0, 1]).infos
        assert {info["shape"] for info in infos} <= set(settings["only"])
        assert all(info["score"] > 0 for info in infos)
