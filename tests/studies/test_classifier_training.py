"""How the digits' classifier is trained, a few steps of it."""

import numpy as np
import pytest

from sada_gym import agents
from sada_gym.envs.digits.agent.network import DigitNetwork
from sada_gym.envs.digits.images import all_digits
from sada_gym.envs.digits.images import test_images as shipped_images
from studies.training.digits.data import batches, training_images
from studies.training.digits.evaluate import accuracy
from studies.training.digits.recipe import RECIPES, ClassifierRecipe
from studies.training.digits.train import train

pytestmark = pytest.mark.slow  # goldens and reference sets guard what is shipped


def test_training_repeats_and_learns():
    recipe = ClassifierRecipe(epochs=2)
    data, validation = training_images(validation=True)
    networks = [train(recipe, data, seed=0) for _ in range(2)]
    assert agents.fingerprint(networks[0]) == agents.fingerprint(networks[1])
    right, loss = accuracy(networks[0], validation)
    assert right / loss > 0.6
    images, labels = next(batches(data, RECIPES["cnn"], np.random.default_rng(0)))
    assert images.shape == (64, 8, 8)
    assert labels.shape == (64,)
    assert not any((images[0] == image).all() for image in data.images)


def test_the_split_is_stratified_and_apart():
    digits, test = all_digits(), shipped_images()
    assert digits.images.shape == (1797, 8, 8)
    assert len(test) == 445
    assert set(np.bincount(test.labels)) <= {43, 44, 45}
    train_part, validation = training_images(validation=True)
    everything, again = training_images()
    assert len(train_part) + len(validation) == len(everything) == 1352
    assert again.sha256 == validation.sha256
    keys = [{image.tobytes() for image in part.images} for part in (train_part, validation, test)]
    assert all(not a & b for i, a in enumerate(keys) for b in keys[i + 1 :])


def test_the_shipped_classifier_keeps_its_promise():
    network = agents.load("cnn", "SADA-Digits")
    right, images = accuracy(network, shipped_images())
    assert right / images >= 0.98
    assert network.architecture == DigitNetwork.architecture
