"""A model of one's own on images of one's own: scores, truths, sentences, files."""

import pytest
from image_toys import Halves, find_square, square, squares
from numpy.testing import assert_array_equal
from PIL import Image

import sada_gym
from sada_gym import ImageApplication, Parameter
from sada_gym.envs.images.conditions import Condition
from sada_gym.errors import Notice, UserError
from sada_gym.testing.purity import assert_pure

pytest.importorskip("cv2")


def detect(**changed):
    images, labels = squares()
    given = {"agent": find_square, "labels": labels, "batch": 3, "agent_id": "bright", **changed}
    return ImageApplication(given.pop("images", images), **given)


def classify(**changed):
    images = [square(10, 20), square(90, 20), square(14, 50), square(95, 60)]
    given = {"agent": Halves().eval(), "labels": [0, 1, 0, 1], "batch": 2, **changed}
    return ImageApplication(images, **given)


def world(application, **values):
    """Return the world of some physical values, all others nominal."""
    mu = application.nominal.copy()
    for name, value in values.items():
        i = application.parameters.names.index(name)
        mu[i] = 2.0 * application.parameters.parameters[i].shares(value) - 1.0
    return mu[None]


@pytest.mark.parametrize("make", [detect, classify])
@pytest.mark.parametrize("conditions", ["common", "all"])
def test_scores_are_pure(make, conditions):
    application = make(conditions=conditions)
    assert_pure(application, n=6, sizes=(2, 4), alone=3, other_process=conditions == "all")


def test_untouched_images_are_the_nominal_world():
    application = detect()
    outcomes = application.evaluate(application.nominal[None], [3])
    assert outcomes.score[0] == application.clean_score == 1.0
    assert application.fooling_threshold == 0.5
    assert classify().fooling_threshold == 0.75  # halfway between all right and a guess
    assert detect(fooling_threshold=0.3).fooling_threshold == 0.3


def test_what_a_condition_hides_is_missed():
    application = detect()
    dark = application.evaluate(world(application, exposure_ev=-3.0), [0])
    assert dark.score[0] == 0.0
    assert dark.infos[0]["right"] == 0
    assert dark.infos[0]["of"] == 3
    said = application.behaviour(dark.infos[0])
    assert said.text == "3 of 3 objects not found: class 1 missed (3)"
    assert said.events == ("class 1 missed",) * 3
    fine = application.evaluate(application.nominal[None], [0]).infos[0]
    assert application.behaviour(fine).text == "all 3 objects found"


def test_objects_move_with_the_image_and_those_outside_do_not_count():
    application = detect(conditions=["rotation", "zoom"])
    mu = world(application, rotation_deg=15.0, zoom=0.7).repeat(4, 0)
    turned = application.evaluate(mu, range(4))
    assert turned.score.min() == 1.0
    # at the image's edge: enlarged twice, it is gone
    edge = ImageApplication(
        [square(2, 2)] * 2,
        agent=find_square,
        labels=[{"boxes": [[2, 2, 26, 26]], "labels": [1]}] * 2,
        conditions=["zoom"],
        agent_id="bright",
    )
    gone = edge.evaluate(world(edge, zoom=2.0), [0])
    assert gone.invalid == {0: "no object that counts is left in its images"}
    hidden = detect(conditions=["occluder"], images=[square(52, 36)], labels=[
        {"boxes": [[52, 36, 76, 60]], "labels": [1]}
    ])  # fmt: skip
    assert hidden.evaluate(world(hidden, occluder_size=0.4), [0]).invalid


def test_without_labels_the_models_own_answers_are_the_truth():
    application = detect(labels=None, task="detect")
    assert application.truth(0).boxes.shape == (1, 4)
    assert application.evaluate(application.nominal[None], [0]).score[0] == 1.0
    assert application.evaluate(world(application, exposure_ev=-3.0), [0]).score[0] == 0.0
    minds = classify(labels=False, task="classify")
    assert minds.clean_score == 1.0


def test_a_classifier_is_scored_by_its_answers_or_its_confidence():
    application = classify(conditions=["contrast", "exposure"])
    infos = application.evaluate(world(application, exposure_ev=3.0), [0]).infos[0]
    assert infos["of"] == 2
    sure = classify(score="confidence")
    assert 0.5 < sure.clean_score < 1.0
    wrong = classify(labels=[0, 1, 0, 0], fooling_threshold=0.5)
    assert wrong.clean_score == 0.75
    seen = wrong.evaluate(wrong.nominal[None].repeat(8, 0), range(8)).infos
    texts = {wrong.behaviour(info).text for info in seen}
    assert "1 of 2 images not classified correctly: left taken for right (1)" in texts


def test_false_alarms_count_in_f1():
    def twice(images):
        answers = find_square(images)
        for answer in answers:
            answer["boxes"] = answer["boxes"].repeat(2, 1) + 0.0
            answer["boxes"][1:] = 0.0
            answer["labels"], answer["scores"] = (
                answer[key].repeat(2) for key in ("labels", "scores")
            )
        return answers

    assert detect(agent=twice).clean_score == 1.0
    application = detect(agent=twice, score="f1")
    assert application.clean_score == pytest.approx(2 / 3)
    info = application.evaluate(application.nominal[None], [0]).infos[0]
    assert application.behaviour(info).text == "all 3 objects found; 3 false alarms"


def test_names_of_labels_and_of_models_are_joined():
    class Named(Halves):
        labels = {"Right": 1, "left": 0}  # noqa: RUF012

    named = classify(agent=Named().eval(), classes=["RIGHT", "left"], labels=[1, 0, 1, 0])
    assert [named.truth(i).classes[0] for i in range(4)] == [0, 1, 0, 1]
    assert named.clean_score == 1.0
    with pytest.raises(UserError, match="among the classes of Named, got 'bird' in image 1"):
        classify(agent=Named().eval(), classes=["left", "bird"])
    with pytest.raises(UserError, match="class to be one of left, right; got 'up'"):
        classify(only=["up"])
    only = classify(only=["left"], batch=4)
    assert only.evaluate(only.nominal[None], [0]).infos[0]["of"] == 2


def test_labels_of_other_classes_than_the_models_get_a_sentence():
    class Many(Halves):
        labels = {}  # noqa: RUF012

        def forward(self, images):
            return super().forward(images).repeat(1, 500)

    with pytest.raises(UserError, match=r"of the 1000 classes that Many tells apart, got 2: up, d"):
        classify(agent=Many().eval(), classes=["up", "down"])
    with pytest.raises(UserError, match=r"of the 2 classes that Halves tells apart, got class 2"):
        classify(labels=[0, 1, 0, 2], score="confidence")
    assert classify(agent=Many().eval(), labels=[0, 1, 0, 1]).clean_score == 1.0


def test_pictures_have_one_size_and_slide_to_the_world():
    for application in (detect(), classify()):
        mu = world(application, exposure_ev=-3.0)[0]
        assert application.render(mu, 0).shape == (450, 960, 3)
        frames, score = application.replay(mu, 0)
        assert {frame.shape for frame in frames} == {(450, 960, 3)}
        assert score == application.evaluate(mu[None], [0]).score[0]
        assert_array_equal(frames[-1], application.render(mu, 0))
        assert application.observation(mu, 0).shape == (360, 480, 3)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"labels": [0] * 6}, "labels for a model that is there to"),
        ({"score": "confidence"}, "score of a model that is there to detect to be one of right"),
        ({"batch": 0}, "batch"),
        ({"iou": 2.0}, "iou from 0 to 1"),
        ({"images": [square(5, 5)], "labels": [{"boxes": [], "labels": []}]}, "objects that count"),
        ({"labels": [{"boxes": [[1, 1, 9, 9]], "labels": [1]}] * 6}, "better than chance"),
        ({"agent": find_square, "labels": None}, "task='classify' or task='detect'"),
    ],
)
def test_what_does_not_fit_gets_a_sentence(changed, told):
    if changed.get("labels") == [0] * 6:
        changed = {**changed, "agent": Detector()}
    with pytest.raises(UserError, match=told):
        detect(**changed)


class Detector:
    """An agent as it is, which says itself what it does."""

    task, names, fingerprint = "detect", {}, "none"

    def found(self, image):
        raise NotImplementedError


def test_a_condition_of_ones_own_needs_a_name_for_the_store():
    red = Condition(
        "red", (Parameter("red", 0.0, 1.0),), (0.0,), change=lambda image, v, rng: image
    )
    assert classify(conditions=["fog", red]).fingerprint is None
    assert classify(conditions=["fog", red], agent_id="mine").fingerprint is not None
    assert classify().fingerprint is not None
    assert classify().settings == classify().settings
    assert classify().settings != classify(conditions={"fog": (100.0, 10_000.0)}).settings


def street(folder):
    """Write images, a model and a file that describes an attack."""
    images, _ = squares()
    (folder / "street").mkdir()
    for i, image in enumerate(images):
        Image.fromarray(image).save(folder / "street" / f"{i}.png")
    (folder / "images_of_ours.py").write_text("from image_toys import find_square\n")
    (folder / "street.toml").write_text(
        'images = "street"\nagent = "images_of_ours:find_square"\ntask = "detect"\n'
        'labels = false\nagent_id = "bright"\nbatch = 2\n[conditions]\nexposure = [-3, 1]\n'
        "fog = true\n"
    )
    return folder / "street.toml"


def test_a_file_describes_images_and_is_attacked(tmp_path):
    file = street(tmp_path)
    run = sada_gym.attack(
        str(file), "random", budget=40, samples=20, out=tmp_path / "run", progress=False
    )
    assert run.parameters.names == ("visibility_m", "exposure_ev")
    combined = run.result.nominal.combined
    assert combined.worlds == 100
    assert combined.failures == run.result.fooled
    low, high = combined.harmless["exposure_ev"]
    assert -3.0 < low < 0.0 < high == 1.0
    rows = dict(run.rows())
    assert "each alone is harmless" in rows["combinations"]
    assert "Harmless alone: visibility" in rows["combinations"]
    assert sada_gym.load_run(tmp_path / "run").open().application.settings["batch"] == 2


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("imagse = 3", r"key in .*street.toml to be one of .*Did you mean images"),
        ("only = 3", "'only' in .*street.toml to be an array"),
        ("conditions = 3", "'conditions'"),
    ],
)
def test_a_bad_key_gets_a_sentence(tmp_path, line, told):
    file = street(tmp_path)
    text = file.read_text().partition("[conditions]")[0]
    file.write_text(f"{text}{line}\n")
    with pytest.raises(UserError, match=told):
        sada_gym.make_application(str(file))


def test_unreadable_images_are_told(tmp_path):
    file = street(tmp_path)
    (tmp_path / "street" / "bad.png").write_bytes(b"bad")
    with pytest.raises(UserError, match=r"an image in .*bad.png"):
        sada_gym.make_application(str(file))
    file.write_text("skip_unreadable = true\n" + file.read_text())
    with pytest.warns(Notice, match="1 of 7 images cannot be read"):
        sada_gym.make_application(str(file))
