"""The photographs of the street: checked, and told where they are missing."""

import numpy as np
import pytest

from sada_gym import make_application
from sada_gym.envs.photos.application import PhotosApplication, missing
from sada_gym.envs.photos.street import VARIABLE, film, street
from sada_gym.errors import MissingPart, UserError
from sada_gym.experiment.names import check_spelling

NEEDED = missing()


def test_what_is_missing_is_told(tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path / "none.avi"))
    with pytest.raises(MissingPart, match=r"none.avi, got no such file. .*opencv-doc.*vtest.avi"):
        film()
    assert "apt install opencv-doc" in missing()
    (tmp_path / "none.avi").write_bytes(b"another film")
    with pytest.raises(MissingPart, match=r"SHA-256 45cddc9490be\.\.\., got"):
        film()


def test_the_class_tells_what_it_is_without_its_parts():
    assert len(PhotosApplication.parameters) == 7
    assert PhotosApplication.fooling_threshold == 0.5


@pytest.mark.skipif(bool(NEEDED), reason=NEEDED)
def test_the_track_takes_the_models_that_images_take(tmp_path):
    for agent, told in (
        ("tcp://127.0.0.1:1", "an agent in tcp://127.0.0.1:1, but nothing answers there"),
        (str(tmp_path / "model.onnx"), "model.onnx, but there is no such file"),
        ("no model", "an agent among coco-centernet, .*got 'no model'"),
    ):
        check_spelling("SADA-Photos-Street-v0", "random", {"agent": agent})
        with pytest.raises(UserError, match=told):
            make_application("SADA-Photos-Street-v0", agent=agent)


@pytest.mark.skipif(bool(NEEDED), reason=NEEDED)
def test_people_are_found_until_the_street_is_dark():
    assert len(street()) == 40
    assert {frame.shape for frame in street()} == {(576, 768, 3)}
    application = make_application("SADA-Photos-Street-v0")
    usual = application.nominal
    dark = usual.copy()
    dark[[4, 5]] = -1.0, 1.0  # three stops less, and the noise of ISO 25,600
    outcomes = application.evaluate(np.stack([usual, dark]), [0, 0])
    assert outcomes.score[0] == 1.0
    assert outcomes.fooled.tolist() == [False, True]
    assert "person missed" in application.behaviour(outcomes.infos[1]).text
