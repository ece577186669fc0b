"""Which parameters the adversary sets, what stands fixed, and what settings say of it."""

import gymnasium as gym
import numpy as np
import pytest

from sada_gym import attack
from sada_gym.analyses.rescore import confirm
from sada_gym.envs.detection import DetectionApplication
from sada_gym.errors import UserError
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.evaluation.problems import make_application
from sada_gym.experiment.target import Target

ID = "SADA-Detection-v0"
CAR = DetectionApplication("car")
PLAIN = {"object_class", "label", "image_size", "renderer", "tile"}


def test_the_default_says_nothing_of_itself_in_settings():
    assert set(CAR.settings) == PLAIN
    named = DetectionApplication("car", parameters="paper", camera_pitch_deg=[0, 51.6])
    assert named.settings == CAR.settings
    assert named.fingerprint == CAR.fingerprint


@pytest.mark.parametrize("name", ["viewpoint", "unpainted"])
def test_a_set_is_a_slice_of_the_papers_box(name):
    application = DetectionApplication("car", parameters=name)
    names, all_names = application.parameters.names, CAR.parameters.names
    mu = np.random.default_rng(0).uniform(-1, 1, (1, len(names))).astype(np.float32)
    scene = application.scene(mu[0], 5)
    fixed = {
        "viewpoint": {"camera_distance": 11.25, "colour_blue": 1, "colour_red": 0},
        "unpainted": {"colour_red": 0.5, "colour_green": 0.5, "colour_blue": 0.5},
    }[name]
    fixed = {**{"colour_green": 0}, **fixed}
    assert set(names) | set(fixed) == set(all_names)
    values = {**application.parameters.describe(mu[0]), **fixed}
    whole = CAR.parameters.normalised([values[name] for name in all_names])
    other = CAR.scene(whole, 5)
    assert scene.shape is other.shape
    for attribute in ("camera_distance", "camera_azimuth_deg", "camera_pitch_deg", "colour",
                      "light_azimuth_deg", "light_pitch_deg"):  # fmt: skip
        np.testing.assert_allclose(
            getattr(scene, attribute), getattr(other, attribute), atol=2e-5, err_msg=attribute
        )


def test_a_pole_moves_from_edge_to_edge():
    application = DetectionApplication("car", parameters="occlusion", image_size=64)
    assert application.parameters.names == ("camera_azimuth_deg", "camera_pitch_deg", "pole_shift")
    scenes = [application.scene(np.array([0, 0, shift], np.float32), 0) for shift in (-1, 0, 1)]
    assert [scene.occluder for scene in scenes] == [-1.0, 0.0, 1.0]
    scene = scenes[0]
    assert (scene.light_azimuth_deg, scene.light_pitch_deg) == (45.0, 45.0)
    assert (scene.camera_distance, scene.colour) == (11.25, (0.0, 0.0, 1.0))
    assert CAR.scene(np.zeros(8, np.float32), 0).occluder is None


def test_no_parameter_of_a_set_is_dead():
    for name in ("viewpoint", "occlusion", "unpainted"):
        application = DetectionApplication("car", parameters=name, image_size=64)
        middle = np.zeros(len(application.parameters), np.float32)
        seen = application.observation(middle, 0)
        for i in range(len(middle)):
            moved = middle.copy()
            moved[i] = 0.8
            assert (application.observation(moved, 0) != seen).any(), (name, i)


def test_settings_are_keywords_that_make_the_same_application():
    keywords = {"object_class": "bus", "parameters": "viewpoint", "camera_pitch_deg": [5, 30]}
    application = make_application(ID, **keywords)
    settings = application.settings
    assert settings["parameters"] == "viewpoint"
    assert settings["camera_pitch_deg"] == [5.0, 30.0]
    label = settings.pop("label")
    again = make_application(ID, **settings)
    assert ApplicationKey.of(again) == ApplicationKey.of(application)
    with Target.of(application, ID).open() as opened:
        assert opened.application.settings == {**settings, "label": label}
        assert opened.target.reference is None


def test_settings_name_our_shapes_where_others_are_the_default():
    class Others(DetectionApplication):
        default_shapes = "toy_parts:first_two"

    assert Others("car").settings["shapes"] == "toy_parts:first_two"
    assert Others("car", shapes="benchmark").settings["shapes"] == "benchmark"
    assert "shapes" not in CAR.settings


def test_the_camera_keeps_to_its_range():
    application = DetectionApplication("car", camera_pitch_deg=(5, 30))
    ends = application.parameters.physical(np.array([-np.ones(8), np.ones(8)]))[:, 2]
    assert ends.tolist() == [5.0, 30.0]


def test_shapes_can_be_chosen():
    name, other = CAR.shapes[3].name, CAR.shapes[1].name
    application = DetectionApplication("car", only=name)
    assert {application.scene(np.zeros(8, np.float32), seed).shape.name for seed in range(9)} == {
        name
    }
    assert application.settings == {**CAR.settings, "only": [name]}
    two = DetectionApplication("car", only=(name, other))
    assert [shape.name for shape in two.shapes] == [other, name]
    assert two.settings["only"] == [name, other]
    with pytest.raises(UserError, match="Expected the shape to be one of car/"):
        DetectionApplication("car", only="bus/city-0")
    with pytest.raises(UserError, match="Expected only to name at least one shape"):
        DetectionApplication("car", only=[])


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"parameters": "view"}, "Expected the parameters to be one of paper, viewpoint"),
        ({"parameters": 3}, "Expected the parameters to be one of"),
        *(
            ({"camera_pitch_deg": given}, "Expected camera_pitch_deg as a range within 0 to 90")
            for given in ([30, 5], [5], 5, "5-30", [5, "30"], [-1, 5], [5, 91], [0, float("nan")])
        ),
    ],
)
def test_bad_input_is_one_sentence(keywords, message):
    with pytest.raises(UserError, match=message):
        DetectionApplication("car", **keywords)


def test_ids_take_the_sets_and_a_run_of_one_is_confirmed(tmp_path):
    with gym.make(ID, parameters="viewpoint", render_mode="rgb_array") as env:
        assert env.action_space.shape == (4,)
        env.reset(seed=0)
        *_, info = env.step(env.action_space.sample())
        assert list(info["parameters"]) == [
            *("camera_azimuth_deg", "camera_pitch_deg"),
            *("light_azimuth_deg", "light_pitch_deg"),
        ]
    keywords = {"object_class": "bus", "parameters": "viewpoint", "image_size": 64}
    run = attack(ID, "random", env_kwargs=keywords, budget=0, samples=3, out=tmp_path / "run",
                 pictures=False)  # fmt: skip
    there = confirm(run.folder, {"image_size": 96}).comparison.there.application.settings
    assert there == {**run.result.settings.experiment.target.application.settings,
                     "image_size": 96}  # fmt: skip
