"""The digits: images and split, warps, score, a user's own classifier and images, bad input."""

import json
from itertools import count, pairwise

import gymnasium as gym
import numpy as np
import pytest
import torch
from scipy.stats import chi2_contingency, chisquare

from sada_gym import agents
from sada_gym.envs.checks import MAX_TILE
from sada_gym.envs.digits import DigitsApplication
from sada_gym.envs.digits.application import NAMES
from sada_gym.envs.digits.classifier import CLASSIFIER_TILE, ClassifierAgent
from sada_gym.envs.digits.images import test_images as shipped_images
from sada_gym.envs.digits.warps import Strokes, Warps, warp
from sada_gym.errors import UserError
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluations import evaluation_seeds
from sada_gym.oracle import Oracle

ANY = DigitsApplication()
RNG = np.random.default_rng(0)
MU = RNG.uniform(-1, 1, (20, 6)).astype(np.float32)


class Brightness(torch.nn.Module):
    """A user's classifier of K classes: the brighter the image, the higher its class."""

    def __init__(self, classes=3):
        super().__init__()
        self.centres = torch.nn.Parameter(torch.linspace(0, 1, classes))
        self.shown = set()  # a list would be hashed as one of its settings
        self.eval()

    def forward(self, images):
        self.shown.add(tuple(images.shape))
        return -50 * (images.mean(dim=(1, 2, 3))[:, None] - self.centres[None]) ** 2


def grey(*levels):
    """An image of 5 x 4 pixels of each level."""
    return np.ones((len(levels), 5, 4)) * np.array(levels)[:, None, None]


OWN = {"images": grey(0.0, 0.5, 1.0, 0.45), "labels": [0, 1, 2, 1]}


def neutral(count, **changed):
    values = {"rotation_deg": 0, "scale": 1, "shear": 0, "shift_px": 0, "contrast": 1, "stroke": 0}
    return Warps(**{k: np.full(count, float(changed.get(k, v))) for k, v in values.items()})


def warped(image, **changed):
    images = np.asarray(image, np.float32)[None]
    return warp(Strokes(images), np.array([0]), neutral(1, **changed))[0]


def test_the_images_are_those_that_the_benchmark_was_measured_on():
    assert shipped_images().sha256.startswith("341169cfb2495be2")


def test_no_warp_changes_nothing():
    for application in (ANY, DigitsApplication(3), DigitsApplication(parameters=NAMES[:2])):
        zeros = np.zeros(len(application.parameters), np.float32)
        for seed in range(len(application.indices)):
            clean, changed = application.attacked_image(zeros, seed)
            np.testing.assert_array_equal(clean, changed)


def test_warps_do_what_they_say():
    image = np.zeros((9, 9))
    image[4, 6] = 1.0  # two to the right of the centre
    assert warped(image, rotation_deg=90)[2, 4] == pytest.approx(1)  # counterclockwise: above it
    assert warped(image, scale=1.5)[4, 7] == pytest.approx(1)
    assert warped(image, shift_px=1)[4, 7] == 1
    assert warped(image, shift_px=0.5)[4, 6:8].tolist() == [0.5, 0.5]
    assert warped(image, shift_px=20).max() == 0
    above = np.zeros((9, 9))
    above[2, 4] = 1.0
    assert warped(above, shear=0.5)[2, 5] == 1
    assert warped(grey(0.75)[0], contrast=0.5)[2, 2] == 0.625
    assert warped(grey(0.9)[0], contrast=1.5)[2, 2] == 1.0


def test_strokes_grow_and_shrink():
    line = np.zeros((7, 7))
    line[:, 2:5] = [0.5, 1.0, 0.6]
    row = warped(line, stroke=1)[3]
    np.testing.assert_allclose(row, [0, 0.25, 0.75, 1, 0.8, 0.3, 0], atol=1e-6)
    row = warped(line, stroke=-1)[3]
    np.testing.assert_allclose(row, [0, 0, 0, 1, 0.12, 0, 0], atol=1e-6)
    ink = [warped(line, stroke=s).sum() for s in np.linspace(-1, 1, 9)]
    assert all(a < b for a, b in pairwise(ink))


def test_score_is_the_true_class_softmax():
    mu, seed = MU[0], 7
    clean, changed = ANY.attacked_image(mu, seed)
    (info,) = ANY.evaluate([mu], [seed]).infos
    with torch.inference_mode():
        logits = ANY.agent(torch.from_numpy(changed)[None, None])[0].double()
    assert info["score"] == pytest.approx(float(torch.softmax(logits, 0)[info["label"]]), abs=1e-5)
    assert info["predicted"] == int(logits.argmax())
    assert info["label"] == shipped_images().labels[info["image"]]
    np.testing.assert_array_equal(clean, shipped_images().images[info["image"]])


def test_seeds_pick_among_the_images_that_are_classified_correctly():
    infos = ANY.evaluate(np.zeros((5_000, 6)), range(5_000)).infos
    assert {info["image"] for info in infos} == {*ANY.indices.tolist()}
    assert all(info["predicted"] == info["label"] for info in infos)
    three = DigitsApplication(3)
    assert {info["label"] for info in three.evaluate(MU, range(20)).infos} == {3}


STREAMS = ("train", "test", "validation")


@pytest.mark.parametrize("digit", range(10))
def test_every_stream_sees_all_images_equally_often(digit):
    application = DigitsApplication(digit)
    images = len(application.indices)
    for stream in STREAMS:
        seeds = evaluation_seeds(0, stream, 0, 100 * images)
        drawn = np.bincount(application._positions(seeds), minlength=images)
        assert chisquare(drawn).pvalue > 1e-4


def test_every_stream_has_the_same_uniform_rate():
    application, size = DigitsApplication(0), 4_000
    mu = np.random.default_rng(0).uniform(-1, 1, (size, 6)).astype(np.float32)
    fooled = [
        application.evaluate(mu, evaluation_seeds(0, stream, 0, size)).fooled.sum()
        for stream in STREAMS
    ]
    table = np.array([[count, size - count] for count in fooled])
    assert chi2_contingency(table).pvalue > 1e-3


def test_a_fixed_image_is_deterministic():
    application = DigitsApplication(image=17)
    score = application.evaluate(np.repeat(MU[:1], 9, axis=0), range(9)).score
    assert len(set(score)) == 1
    wrong = sorted({*range(445)} - {*ANY.indices.tolist()})
    unlucky = DigitsApplication(image=wrong[0]).evaluate(np.zeros((1, 6)), [0]).infos[0]
    assert unlucky["predicted"] != unlucky["label"]


def test_chosen_parameters_stand_in_the_order_given():
    application = DigitsApplication(image=0, parameters=["stroke", "rotation_deg"])
    assert application.parameters.names == ("stroke", "rotation_deg")
    every = np.zeros((20, 6), np.float32)
    every[:, [5, 0]] = MU[:, :2]
    expected = DigitsApplication(image=0).evaluate(every, [0] * 20).score
    np.testing.assert_array_equal(application.evaluate(MU[:, :2], [0] * 20).score, expected)


def test_golden_scores():
    """Scores that published results rest on; other arithmetic differs in the last digits."""
    mu = np.round(np.random.default_rng(42).uniform(-1, 1, (8, 6)), 2)
    score = ANY.evaluate(mu, range(100, 108)).score
    np.testing.assert_allclose(score, GOLDEN, atol=1e-5)


GOLDEN = [0.99751, 0.243653, 1.0, 1.0, 0.022531, 0.94205, 0.999952, 0.997067]


def test_uniform_mu_fool_sometimes():
    rng = np.random.default_rng(3)
    mu, seeds = rng.uniform(-1, 1, (2_000, 6)), rng.integers(2**31, size=2_000).tolist()
    assert 0.2 < ANY.evaluate(mu, seeds).fooled.mean() < 0.32


def test_the_ranges_of_the_docs():
    ends = ANY.parameters.physical(np.array([-np.ones(6), np.ones(6)]))
    np.testing.assert_allclose(ends[0], [-35, 0.75, -0.3, -1, 0.5, -1])
    np.testing.assert_allclose(ends[1], [35, 1.25, 0.3, 1, 1.5, 1])
    wide = DigitsApplication(image=0, agent=Brightness(), **OWN)
    assert wide.parameters.physical(np.ones(6))[3] == 0.5


def test_pictures():
    env = gym.make("SADA-Digits-3-v0", render_mode="rgb_array")
    env.reset(seed=4)
    before = env.render()
    info = env.step(MU[0])[4]
    frame = env.render()
    assert before.shape == frame.shape == (248, 344, 3)
    assert (frame != before).any()
    seen = env.unwrapped.application.observation(MU[0], info["seed"])
    assert seen.shape == (160, 160, 3)
    _, changed = env.unwrapped.application.attacked_image(MU[0], info["seed"])
    np.testing.assert_allclose(seen[::20, ::20, 0], 255 * changed, atol=0.51)


def test_a_users_classifier_and_images():
    model = Brightness()
    application = DigitsApplication(agent=model, **OWN)
    assert application.tile == 1
    assert model.shown == {(1, 1, 5, 4)}
    infos = application.evaluate(np.zeros((40, 6)), range(40)).infos
    assert {(info["image"], info["label"]) for info in infos} == {(0, 0), (1, 1), (2, 2), (3, 1)}
    assert application.render(np.zeros(6), 1).ndim == 3
    model.shown.clear()
    DigitsApplication(1, agent=model, tile=3, **OWN)
    assert model.shown == {(3, 1, 5, 4)}


def test_fingerprints_and_settings():
    tracks = [DigitsApplication(digit) for digit in (3, 4)]
    assert tracks[0].fingerprint == tracks[1].fingerprint is not None
    assert tracks[0].settings != tracks[1].settings
    json.dumps(tracks[0].settings)
    model = Brightness()
    own = DigitsApplication(agent=model, **OWN).fingerprint
    assert own == DigitsApplication(agent=model, **OWN).fingerprint
    other = {**OWN, "images": OWN["images"] * np.float32(0.999)}
    relabelled = {**OWN, "labels": [0, 1, 2, 0]}
    prints = {DigitsApplication(agent=model, **data).fingerprint for data in (other, relabelled)}
    assert len({own, *prints}) == 3
    function = DigitsApplication(agent=lambda images: model(images), **OWN)
    assert function.fingerprint is None
    named = DigitsApplication(agent=model.forward, agent_id="mine-1", **OWN)
    assert named.fingerprint is not None
    label = int(shipped_images().labels[10])
    assert DigitsApplication(label, image=10).settings == DigitsApplication(image=10).settings


def test_a_users_images_cannot_be_changed_later():
    images = grey(0.0, 0.5)
    application = DigitsApplication(agent=Brightness(), images=images, labels=[0, 1])
    before = application.fingerprint
    images[:] = 1.0
    assert application.fingerprint == before


def test_a_store_keeps_images_apart(tmp_path):
    for data in (OWN, {**OWN, "images": grey(0.0, 0.55, 1.0, 0.45)}):
        application = DigitsApplication(agent=Brightness(), **data)
        with Oracle(application, budget=20, seed=0, store=tmp_path / "s.sqlite") as oracle:
            oracle(MU)
    with EvaluationStore(tmp_path / "s.sqlite") as store:
        assert len(store) == 40


class Gives(torch.nn.Module):
    """A classifier with this output."""

    def __init__(self, output):
        super().__init__()
        self.output = output
        self.eval()

    def forward(self, images):
        return self.output


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (torch.zeros(1), r"an output of shape \(1, K\) .*, got \(1,\)\. The classifier must"),
        (torch.zeros(2, 10), r"an output of shape \(1, K\) .*, got \(2, 10\)"),
        (torch.zeros(1, 1), r"K of at least 2, got \(1, 1\)"),
        (torch.zeros(1, 3, 4), r"got \(1, 3, 4\)"),
        (torch.full((1, 10), torch.nan), "finite numbers from the classifier, got NaN"),
        (torch.zeros(1, 10, dtype=torch.int64), "an output of floats .*, got torch.int64"),
        ([0.0] * 10, "Expected a tensor from the classifier, got list"),
        (None, "Expected a tensor from the classifier, got NoneType"),
        ("5", "Expected a tensor from the classifier, got str"),
        ({"logits": torch.zeros(1, 10)}, "Expected a tensor from the classifier, got dict"),
        ((step for step in range(3)), "Expected a tensor from the classifier, got generator"),
        (np.zeros((1, 10), np.float32), "Expected a tensor from the classifier, got ndarray"),
        (torch.zeros(0, 10), r"got \(0, 10\)"),
        (torch.tensor(1.0), r"got \(\)"),
        (torch.full((1, 10), torch.inf), "finite numbers from the classifier, got NaN"),
        (torch.zeros(1, 10, dtype=torch.bool), "an output of floats .*, got torch.bool"),
        (torch.zeros(1, 10, dtype=torch.complex64), "an output of floats .*, got torch.complex64"),
        (torch.zeros(1, 10).to_sparse(), r"takes \(1, 1, 8, 8\) .*, got .*[sS]parse"),
        (torch.zeros(1, 10, device="meta"), r"takes \(1, 1, 8, 8\) .*, got .*meta"),
        (torch.full((1, 10), 0.1), "Expected logits .*, got probabilities, .* without its softmax"),
    ],
)
def test_a_bad_classifier_is_refused(output, message):
    with pytest.raises(ValueError, match=message):
        DigitsApplication(3, agent=Gives(output))


@pytest.mark.parametrize(
    "error",
    [RuntimeError("a"), KeyError("b"), ZeroDivisionError(), AssertionError(), OSError("no disk")],
)
def test_whatever_a_classifier_raises_is_told_as_its_own(error):
    def raises(images):
        raise error

    with pytest.raises(UserError, match=rf"takes \(1, 1, 8, 8\).*got {type(error).__name__}"):
        DigitsApplication(3, agent=raises)


class Linear(torch.nn.Module):
    """Logits of ten classes with the given format."""

    def __init__(self, convert):
        super().__init__()
        torch.manual_seed(0)
        self.layer, self.convert = torch.nn.Linear(64, 10), convert
        self.eval()

    def forward(self, images):
        return self.convert(self.layer(images.flatten(1)))


def test_the_format_of_logits_does_not_matter():
    """Wider floats, a gradient, another layout and the softmax's logarithm give equal scores."""
    mu, seeds = np.random.default_rng(0).uniform(-1, 1, (5, 6)), range(5)
    layer = Linear(lambda logits: logits)
    expected = DigitsApplication(image=3, agent=layer).evaluate(mu, seeds).score
    formats = [
        lambda logits: logits.double(),
        lambda logits: logits.clone().requires_grad_(),
        lambda logits: logits.t().contiguous().t(),
        lambda logits: logits.log_softmax(dim=1),
    ]
    for convert in formats:
        score = DigitsApplication(image=3, agent=Linear(convert)).evaluate(mu, seeds).score
        np.testing.assert_allclose(score, expected, rtol=1e-6)
    with pytest.raises(UserError, match="got probabilities"):
        DigitsApplication(agent=Linear(lambda logits: logits.softmax(dim=1)))


def test_a_classifier_that_loses_classes_later_is_refused():
    classes = [10]
    agent = Linear(lambda logits: logits[:, : classes[0]])
    application = DigitsApplication(image=3, agent=agent)
    classes[0] = 3
    with pytest.raises(UserError, match="Expected the same K for every batch"):
        application.evaluate(np.zeros((1, 6)), [0])


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (
            torch.nn.Conv2d(3, 4, 3),
            r"takes \(1, 1, 5, 4\) float32 on the CPU, got RuntimeError: Giv",
        ),
        (torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(20, 3)).double(), "same dtype"),
        (lambda first, second: first, "got TypeError: .*'second'.* must take"),
    ],
)
def test_a_classifier_that_cannot_take_the_images_is_refused(model, message):
    if isinstance(model, torch.nn.Module):
        model.eval()
    with pytest.raises(ValueError, match=message):
        DigitsApplication(agent=model, **OWN)


class Growing(Brightness):
    """A classifier with another K in every call."""

    calls = count()

    def forward(self, images):
        return torch.nn.functional.pad(super().forward(images), (0, next(self.calls)))


def test_a_classifier_whose_number_of_classes_changes_is_refused():
    with pytest.raises(ValueError, match="Expected the same K for every batch"):
        DigitsApplication(agent=Growing(), **OWN)


@pytest.mark.parametrize(
    ("images", "labels", "message"),
    [
        (grey(0.5), None, "Expected images= and labels= together, got images alone. Pass labels"),
        (None, [1], "got labels alone. Pass images"),
        (grey(0.5)[0], [1], r"of shape \(n, height, width\), got \(5, 4\). Pass image\[None\]"),
        (grey(0.5)[..., None], [1], r"got \(1, 5, 4, 1\). They are grey"),
        (grey(1.5), [1], r"images within \[0, 1\], got 1.5 in image 0"),
        (grey(0.5, -0.1), [1, 1], r"got -0.1 in image 1"),
        (grey(np.nan), [1], r"images within \[0, 1\], got nan"),
        (np.full((1, 5, 4), 255), [1], r"floats in \[0, 1\], got dtype int64. Divide"),
        (np.zeros((0, 5, 4)), [], r"got \(0, 5, 4\)"),
        (np.zeros((1, 300, 4)), [1], "at most 256 pixels a side"),
        ([[[0.0], [0.0, 1.0]]], [1], "Expected images to be an array of real numbers"),
        (np.ma.masked_array(grey(0.5), True), [1], "Expected images without a mask, got a masked"),
        (grey(0.5), np.ma.masked_array([1], [True]), "Expected labels without a mask"),
        (grey(0.5), [1, 2], r"Expected 1 labels, .*, got shape \(2,\)"),
        (grey(0.5), [1.0], "dtype float64"),
        (grey(0.5), [-1], "from 0 for each image"),
    ],
)
def test_bad_images_are_refused(images, labels, message):
    with pytest.raises(ValueError, match=message):
        DigitsApplication(agent=Brightness(), images=images, labels=labels)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"image": 445}, "Expected image to be an index from 0 to 444, got 445"),
        ({"image": -1}, "from 0 to 444, got -1"),
        ({"image": 1.0}, "from 0 to 444, got 1.0"),
        ({"digit": 10}, "Expected digit to be a class among 0, 1, .*, 9, got 10"),
        ({"digit": "3"}, "got '3'"),
        ({"digit": 3.0}, "Expected digit to be a class among .*, got 3.0"),
        ({"digit": np.array([3, 4])}, r"Expected digit to be .*, got array\(\[3, 4\]\)"),
        ({"digit": 5, "image": 0}, "Expected an image of digit 5, got image 0, whose label is 0"),
        ({"parameters": ["scale", "rotaton_deg"]}, "got 'rotaton_deg'. Did you mean rotation_deg"),
        ({"parameters": ["scale", "scale"]}, "Expected each parameter once, got scale, scale"),
        ({"parameters": ["scale"]}, "Expected at least 2 parameters .*, got 1: scale"),
        ({"parameters": []}, "got 0: none"),
        ({"parameters": "scale"}, "Expected parameters to be a list of names"),
        ({"tile": 0}, f"an int from 1 to {MAX_TILE}, got 0"),
        ({"tile": True}, "got True"),
        ({"agent": "cn"}, "Expected an agent's name among cnn, .* got 'cn'. Did you mean 'cnn'"),
    ],
)
def test_bad_keywords_are_refused(keywords, message):
    with pytest.raises(ValueError, match=message):
        DigitsApplication(**keywords)


def test_tiles():
    images = shipped_images().images[:40]
    network = agents.load("cnn", "SADA-Digits")
    assert ClassifierAgent(network).tile == CLASSIFIER_TILE
    alone = np.concatenate([ClassifierAgent(network).act(image[None]) for image in images])
    np.testing.assert_array_equal(ClassifierAgent(network).act(images), alone)
    answers = ClassifierAgent(network, tile=1).act(images)
    np.testing.assert_allclose(answers, alone, atol=1e-4)
