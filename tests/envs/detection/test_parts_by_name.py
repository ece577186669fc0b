"""Renderers and shapes chosen by a name: in ids, stores, workers and messages."""

import gymnasium as gym
import numpy as np
import pytest
from toy_parts import Flat

from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection import frame as detection_frame
from sada_gym.envs.detection.renderers import default_renderer
from sada_gym.envs.detection.renderers.base import RENDERERS
from sada_gym.envs.detection.shapes.registry import SHAPES
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.evaluation.problems import make_application
from sada_gym.experiment.target import Target
from sada_gym.oracle import Oracle

ID = "SADA-Detection-v0"
MU = np.random.default_rng(0).uniform(-1, 1, (6, 8)).astype(np.float32)


@pytest.fixture
def toy_rows(monkeypatch):
    """A row in each table: all that a new part needs."""
    monkeypatch.setitem(RENDERERS, "flat", "toy_parts:Flat")
    monkeypatch.setitem(SHAPES, "first-two", "toy_parts:first_two")


def test_the_defaults_by_name_are_the_defaults():
    default = DetectionApplication("car")
    for renderer, shapes in (("rasteriser", "benchmark"), ("Rasteriser", None)):
        named = DetectionApplication("car", renderer=renderer, shapes=shapes)
        assert named.settings == default.settings
        assert named.settings["renderer"] == "Rasteriser"
        assert named.fingerprint == default.fingerprint
        assert named.shapes is default.shapes
        assert named.renderer is default_renderer()


def test_a_row_makes_a_part_known_to_ids(toy_rows):
    with gym.make(ID, renderer="flat", shapes="first-two") as env:
        application = env.unwrapped.application
        assert len(application.shapes) == 2
        np.testing.assert_array_equal(application.observation(MU[0], 7), np.full((128, 128, 3), 7))
        env.reset(seed=3)
        assert env.step(MU[0])[-1]["score"] == application.evaluate(MU[:1], [3]).score[0]


def test_settings_are_keywords_that_make_the_same_application(toy_rows):
    application = make_application(ID, object_class="bus", renderer="flat", shapes="first-two")
    settings = application.settings
    assert settings["renderer"] == "flat"
    assert settings["shapes"] == "first-two"
    del settings["label"]  # the detector's own
    again = make_application(ID, **settings)
    assert ApplicationKey.of(again) == ApplicationKey.of(application)
    with Target.of(application, ID).open() as opened:  # as replays and entries do
        assert ApplicationKey.of(opened.application) == ApplicationKey.of(application)


def test_stores_tell_parts_and_their_versions_apart(toy_rows, monkeypatch):
    keywords = ({}, {"renderer": "flat"}, {"shapes": "first-two"})
    made = [make_application(ID, **given) for given in keywords]
    keys = [ApplicationKey.of(application).model_dump_json() for application in made]
    monkeypatch.setattr(Flat, "version", 2)
    keys.append(ApplicationKey.of(make_application(ID, renderer="flat")).model_dump_json())
    assert len(set(keys)) == 4


@pytest.mark.long
def test_workers_make_the_parts_themselves():
    keywords = {"renderer": "toy_parts:Flat", "shapes": "toy_parts:first_two"}
    scores = []
    for workers in (1, 2):
        with Oracle(ID, env_kwargs=keywords, budget=6, seed=0, workers=workers) as oracle:
            scores.append(oracle(MU))
    np.testing.assert_array_equal(*scores)


def test_whoever_makes_a_renderer_closes_it(toy_rows, monkeypatch):
    closed = []
    monkeypatch.setattr(type(default_renderer()), "close", closed.append)
    with gym.make(ID, renderer="flat") as env:
        renderer = env.unwrapped.application.renderer
    assert renderer.closed == 1
    for keywords in ({}, {"renderer": "rasteriser"}, {"renderer": default_renderer()}):
        gym.make(ID, **keywords).close()
    assert closed == []


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        (
            {"renderer": "rasterizer"},
            r"renderer to be one of rasteriser, blender; .*mean rasteriser\?",
        ),
        ({"renderer": "no_module:Flat"}, r"Expected a renderer's name or module:Class.*no_module"),
        ({"renderer": "toy_parts:Missing"}, r"Expected a renderer's name or module:Class"),
        ({"renderer": "toy_parts:first_two"}, r"'toy_parts:first_two' to be a subclass of Render"),
        (
            {"shapes": "benchmrk"},
            r"name among benchmark, .*, textured or a folder .*mean 'benchmark'\?",
        ),
        ({"shapes": "no/folder"}, r"Expected a folder of CAD files, got no/folder"),
        ({"shapes": "toy_parts:missing"}, r"Expected a shape set's name or module:Class"),
        ({"shapes": "toy_parts:no_shapes"}, r"tuple of Shape objects from 'toy_parts:no_shapes'"),
        (
            {"shapes": 3},
            r"shapes to be a name among benchmark, .*, textured or the path of a folder, got 3",
        ),
    ],
)
def test_unknown_parts_get_a_sentence(keywords, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message):
        make_application(ID, **keywords)


def test_a_renderer_says_whether_videos_may_ask_for_larger_pictures(monkeypatch):
    application = DetectionApplication("car", renderer=Flat())
    way, side = MU[:2], detection_frame.SIDE
    asked = []
    draw = Flat.render_batch
    monkeypatch.setattr(
        Flat, "render_batch", lambda self, *given: asked.append(given[1]) or draw(self, *given)
    )
    for any_size, sizes in ((False, [128]), (True, [side, 128])):
        asked.clear()
        monkeypatch.setattr(Flat, "any_size", any_size)
        views = [*application.film_batch(way, [0, 0])]
        assert [view.shape for view in views] == [(side, side, 3)] * 2
        assert asked == sizes
