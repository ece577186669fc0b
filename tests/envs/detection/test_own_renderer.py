"""A renderer of a user's own: its identity, what it gives back, who closes it."""

import hashlib
import json

import numpy as np
import pytest

from sada_gym.envs.adversary import AdversaryEnv
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.renderers import Renderer, Rendering, default_renderer
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.oracle import Oracle

MU = np.random.default_rng(0).uniform(-1, 1, (5, 8)).astype(np.float32)


class Grey(Renderer):
    """A renderer whose pictures depend on a setting."""

    def __init__(self, level=128, identity=None):
        self.level, self.scenes, self.closed = level, [], 0
        self._identity = identity

    @property
    def identity(self):
        return self._identity

    def render_batch(self, scenes, image_size):
        self.scenes.append(list(scenes))
        image = np.full((image_size, image_size, 3), self.level, np.uint8)
        return [Rendering(image, np.zeros(image.shape[:2], bool), None) for _ in scenes]

    def close(self):
        self.closed += 1


def grey(level):
    return Grey(level, json.dumps({"name": "grey", "version": 1, "level": level}))


def test_a_batch_is_rendered_in_one_call():
    renderer = grey(128)
    application = DetectionApplication("car", renderer=renderer)
    infos = application.evaluate(MU, range(5)).infos
    np.testing.assert_array_equal(infos[0]["box"], np.zeros(4))
    (scenes,) = renderer.scenes
    assert [scene.seed for scene in scenes] == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(application.observation(MU[0], 0), np.full((128, 128, 3), 128))


def test_settings_hold_the_identity_hashed():
    dark, light = (DetectionApplication("car", renderer=grey(level)) for level in (40, 200))
    digest = hashlib.sha256(dark._renderer.identity.encode()).hexdigest()
    assert dark.settings["renderer"] == f"Grey-{digest}"
    assert dark.settings != light.settings
    assert dark.settings == DetectionApplication("car", renderer=grey(40)).settings


def test_the_default_renderers_name_is_that_of_published_results():
    for renderer in (None, default_renderer()):
        application = DetectionApplication("car", renderer=renderer)
        assert application.settings["renderer"] == "Rasteriser"

    class Rasteriser(Grey):
        pass

    mine = DetectionApplication("car", renderer=Rasteriser(identity="Rasteriser"))
    assert mine.settings["renderer"] != "Rasteriser"


def test_a_store_tells_a_renderers_settings_apart(tmp_path):
    """By the class's name alone, the second would be handed the first one's scores."""
    asked = []
    for renderer in (grey(40), grey(200), grey(40)):
        application = DetectionApplication("car", renderer=renderer)
        with Oracle(application, budget=5, seed=0, store=tmp_path / "scores.sqlite") as oracle:
            oracle(MU)
        asked.append(sum(map(len, renderer.scenes)))
    assert asked == [5, 5, 0]


def test_a_renderer_without_an_identity_is_refused_for_stores():
    application = DetectionApplication("car", renderer=Grey())
    assert application.fingerprint is None
    with pytest.raises(ValueError, match=r"your own renderer an `identity`"):
        ApplicationKey.of(application)
    application.evaluate(MU, range(5))


class Broken(Grey):
    def __init__(self, answer):
        super().__init__()
        self.answer = answer

    def render_batch(self, scenes, image_size):
        return self.answer(super().render_batch(scenes, image_size))


IMAGE, MASK = np.zeros((128, 128, 3), np.uint8), np.zeros((128, 128), bool)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda good: good[:0], r"Expected 1 renderings from Broken\.render_batch.*got 0 items"),
        (lambda good: None, r"Expected 1 renderings .* got None"),
        (lambda good: [IMAGE], r"Expected Rendering objects"),
        (lambda good: [Rendering(IMAGE[:9], MASK, None)], r"image of shape \(128, 128, 3\)"),
        (lambda good: [Rendering(IMAGE / 255, MASK, None)], r"dtype uint8 .* dtype float64"),
        (lambda good: [Rendering(IMAGE, IMAGE, None)], r"mask of shape \(128, 128\)"),
        (lambda good: [Rendering(IMAGE, MASK, np.full(4, np.nan))], r"box of four finite numbers"),
    ],
)
def test_what_a_renderer_gives_is_checked(answer, message):
    application = DetectionApplication("car", renderer=Broken(answer))
    with pytest.raises(ValueError, match=message):
        application.evaluate(MU[:1], [0])


def test_what_is_no_renderer_is_refused():
    with pytest.raises(ValueError, match=r"Expected a renderer that is .*Subclass Renderer"):
        DetectionApplication("car", renderer=object())
    for identity in ("", 3, b"x"):
        with pytest.raises(ValueError, match=r"identity of Grey to be a text"):
            DetectionApplication("car", renderer=Grey(identity=identity))


def test_a_renderer_that_is_handed_in_stays_open():
    renderer = grey(1)
    AdversaryEnv(DetectionApplication("car", renderer=renderer)).close()
    assert renderer.closed == 0
