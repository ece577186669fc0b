"""`sada-gym init --images`: from a folder of images and a model to a file that is attacked."""

import json

import pytest
import torch
from image_toys import Halves, square
from PIL import Image
from typer.testing import CliRunner

from sada_gym import make_application
from sada_gym.cli import app

pytest.importorskip("cv2")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder for each class, a model, and nothing else."""
    for name, x in (("left", 10), ("right", 90)):
        (tmp_path / "boxes" / name).mkdir(parents=True)
        for y in (10, 30, 50):
            Image.fromarray(square(x, y)).save(tmp_path / "boxes" / name / f"{y}.png")
    torch.jit.script(Halves().eval()).save(tmp_path / "halves.pt")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def init(*words):
    return CliRunner().invoke(app, ["init", *words])


def test_a_folder_and_a_model_become_a_file_that_is_attacked(folder):
    told = json.loads(init("--images", "boxes", "--agent", "halves.pt", "--json").stdout)
    assert told["file"] == "boxes.toml"
    assert told["notes"][0] == "Of 6 images: 100 % right untouched."
    assert 'agent = "halves.pt"' in told["text"]
    assert "# rain = true  # rain 0 to 50 mm/h" in told["text"]
    application = make_application("boxes.toml")
    assert application.clean_score == 1.0
    assert application.fooling_threshold == 0.75
    assert len(application.parameters) == 7
    # from another folder, too
    (folder / "elsewhere").mkdir()
    init("--images", "boxes", "--agent", "halves.pt", "--out", "elsewhere/mine.toml")
    assert 'images = "../boxes"' in (folder / "elsewhere" / "mine.toml").read_text()
    assert len(make_application("elsewhere/mine.toml").images) == 6


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "Expected an environment's ID or --images FOLDER, got none."),
        (["CartPole-v1", "--images", "boxes"], "--images FOLDER, got both."),
        (["--images", "boxes"], "Expected the model by --agent with --images, got none."),
        (["--images", "none", "--agent", "halves.pt"], "a folder of images, got none"),
        (["--images", "boxes", "--agent", "none.onnx"], "none.onnx"),
    ],
)
def test_what_is_missing_gets_a_sentence(folder, words, told):
    answer = init(*words)
    assert answer.exit_code == 2
    assert told in " ".join(answer.stderr.split())
    assert not [*folder.glob("*.toml")]
