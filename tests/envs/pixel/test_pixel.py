"""The pixel attack: noise and its bounds, score, which image, bad input."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from sada_gym import agents
from sada_gym.envs.digits import DigitsApplication
from sada_gym.envs.digits.images import test_images as shipped_images
from sada_gym.envs.pixel import PixelApplication

ONE = PixelApplication()
RNG = np.random.default_rng(0)
MU = RNG.uniform(-1, 1, (30, 64)).astype(np.float32)


class Logits(torch.nn.Module):
    """A user's classifier: the logits of image (1, 3) are its pixels, times a factor."""

    def __init__(self, factor=1.0):
        super().__init__()
        self.factor = factor
        self.eval()

    def forward(self, images):
        return self.factor * images.flatten(1)


THREE = {"images": [[[0.2, 0.7, 0.5]]], "labels": [1]}


@pytest.mark.parametrize("radius", [0.01, 0.15, 0.6, 1.0])
def test_every_image_within_the_radius_can_be_reached_and_no_other(radius):
    application = PixelApplication(image=4, radius=radius)
    clean = shipped_images().images[4].astype(np.float64)
    corners = np.sign(MU)
    for mu in (*MU, *corners):
        changed = application.attacked_image(mu, 0)[1]
        assert 0 <= changed.min() <= changed.max() <= 1
        assert np.abs(changed - clean).max() <= radius + 1e-7
    for sign, end in ((1, np.minimum(clean + radius, 1)), (-1, np.maximum(clean - radius, 0))):
        changed = application.attacked_image(np.full(64, sign), 0)[1]
        np.testing.assert_allclose(changed, end, atol=1e-6)


def test_no_noise_changes_nothing():
    clean, changed = ONE.attacked_image(np.zeros(64), 0)
    np.testing.assert_array_equal(clean, changed)


def test_each_number_changes_its_own_pixel():
    clean, changed = PixelApplication(radius=0.5).attacked_image(np.eye(64)[19], 0)
    assert np.argwhere(clean != changed).tolist() == [[2, 3]]
    assert ONE.parameters.names[19] == "row2_column3"


def test_score_is_the_lead_of_the_true_class():
    application = PixelApplication(agent=Logits(4.0), radius=0.25, **THREE)
    for mu, lead in (([0, 0, 0], True), ([1, -1, 1], False), ([0, -0.4, 0.4], False)):
        (info,) = application.evaluate([mu], [0]).infos
        pixels = np.clip(np.array([0.2, 0.7, 0.5]) + 0.25 * np.array(mu), 0, 1)
        p = np.exp(4 * pixels) / np.exp(4 * pixels).sum()
        expected = max(p[1] - max(p[0], p[2]), 0)
        assert info["score"] == pytest.approx(expected, abs=1e-6)
        assert info["fooled"] == (info["score"] == 0)
        assert (info["score"] > 0) == lead


def test_a_tie_fools():
    tied = {"images": [[[0.5, 0.5, 0.25]]], "labels": [1]}
    outcomes = PixelApplication(image=0, agent=Logits(), **tied).evaluate(np.zeros((1, 3)), [0])
    assert outcomes.score[0] == 0
    assert outcomes.fooled[0]


def test_by_default_one_image_is_attacked():
    assert ONE.image == 0
    infos = ONE.evaluate(np.repeat(MU[:1], 5, axis=0), range(5)).infos
    assert len({info["score"] for info in infos}) == 1
    assert {info["image"] for info in infos} == {0}
    assert ONE.settings == PixelApplication(image=0).settings
    wrong_first = {"images": [[[0.9, 0.1, 0.0]], *THREE["images"]], "labels": [1, 1]}
    assert PixelApplication(agent=Logits(), **wrong_first).image == 1


def test_with_a_digit_the_seed_picks_the_image():
    application = PixelApplication(digit=7)
    infos = application.evaluate(np.zeros((500, 64)), range(500)).infos
    assert {info["image"] for info in infos} == {*application.indices.tolist()}
    assert {info["label"] for info in infos} == {7}


def test_the_agent_is_the_digits():
    assert ONE.fingerprint == DigitsApplication().fingerprint
    assert agents.card("cnn", "SADA-Pixel").path == agents.card("cnn", "SADA-Digits").path
    assert ONE.settings != PixelApplication(radius=0.2).settings


def test_golden_scores():
    """Scores that published results rest on; other arithmetic differs in the last digits."""
    mu = np.sign(np.random.default_rng(42).uniform(-1, 1, (6, 64)))
    scores = [
        PixelApplication(image, radius=0.4).evaluate(row[None], [0]).score[0]
        for image, row in zip((0, 3, 8, 50, 100, 200), mu, strict=True)
    ]
    np.testing.assert_allclose(scores, GOLDEN, atol=1e-5)


GOLDEN = [0.999339, 0.996588, 0.999979, 0.0, 0.0, 0.988319]


def test_a_white_box_fools_where_random_noise_does_not():
    image = torch.from_numpy(shipped_images().images[:1].copy())[:, None]
    network = agents.load("cnn", "SADA-Digits")
    moved = image.clone().requires_grad_(True)
    loss = torch.nn.functional.cross_entropy(network(moved), torch.tensor([0]))
    (gradient,) = torch.autograd.grad(loss, moved)
    application = PixelApplication(image=0, radius=0.25)
    mu = gradient.sign().flatten().numpy()
    assert application.evaluate([mu], [0]).fooled[0]
    assert application.evaluate(MU, [0] * 30).fooled.mean() < 0.1


def test_pictures():
    env = gym.make("SADA-Pixel-v0", render_mode="rgb_array", radius=0.4)
    env.reset(seed=0)
    before = env.render()
    info = env.step(MU[0])[4]
    assert before.shape == env.render().shape == (248, 344, 3)
    frames, score = env.unwrapped.replay(MU[0], info["seed"])
    assert score == info["score"]
    np.testing.assert_array_equal(frames[0], env.render())


@pytest.mark.parametrize("radius", [0, -0.1, 1.01, np.nan, np.inf, "0.1", True, None])
def test_a_radius_outside_is_refused(radius):
    with pytest.raises(ValueError, match=r"Expected radius .*\(0, 1\], got"):
        PixelApplication(radius=radius)


def test_an_unknown_image_is_refused():
    with pytest.raises(ValueError, match="Expected image to be an index from 0 to 444, got 500"):
        gym.make("SADA-Pixel-v0", image=500)
