"""Models of all kinds: what they get, what they tell, and what is wrong with others."""

import pickle

import numpy as np
import pytest
import torch
from image_toys import Halves, find_square, square
from numpy.testing import assert_allclose, assert_array_equal
from torch import nn

from sada_gym.envs.images.models import (
    Model,
    OnnxModel,
    Preparation,
    classified,
    decoded,
    find_model,
    prepared,
)
from sada_gym.errors import UserError

pytest.importorskip("cv2")


def onnx_file(path, shape, output, kind=1, metadata=()):
    """Write a model that adds the input's mean, times 0, to a constant output."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    make = onnx.helper
    values = onnx.numpy_helper.from_array(np.asarray(output, np.float32), "values")
    nought = onnx.numpy_helper.from_array(np.zeros((), np.float32), "nought")
    nodes = [
        make.make_node("Cast", ["images"], ["floats"], to=1),
        make.make_node("ReduceMean", ["floats"], ["mean"], keepdims=0),
        make.make_node("Mul", ["mean", "nought"], ["zero"]),
        make.make_node("Add", ["values", "zero"], ["told"]),
    ]
    graph = make.make_graph(
        nodes,
        "toy",
        [make.make_tensor_value_info("images", kind, shape)],
        [make.make_tensor_value_info("told", 1, np.shape(output))],
        [values, nought],
    )
    model = make.make_model(graph, opset_imports=[make.make_opsetid("", 17)], ir_version=9)
    for key, value in metadata:
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.save(model, path)
    return path


def test_a_classifier_gets_what_it_was_trained_on():
    image = square(10, 10)
    whole = prepared(image, Preparation())
    assert whole.shape == (1, 3, 96, 128)
    assert_allclose(whole[0, 0], image[..., 0] / 255.0, atol=1e-6)
    small = prepared(image, Preparation(size=32, imagenet=True))
    assert small.shape == (1, 3, 32, 32)
    assert_allclose(small.mean(), -0.5, atol=0.4)


def test_logits_and_probabilities_become_the_same():
    shares = classified(torch.tensor([[0.1, 0.7, 0.2]], dtype=torch.float64))
    assert shares.classes.tolist() == [1]
    assert_allclose(shares.probabilities, [0.1, 0.7, 0.2])
    logits = classified(np.log([0.1, 0.7, 0.2]))
    assert_allclose(logits.probabilities, shares.probabilities)


@pytest.mark.parametrize(
    ("output", "told"),
    [
        (np.zeros((2, 3)), r"\(1, K\) numbers"),
        (np.zeros((1, 1)), "K of at least 2"),
        (np.array([[np.nan, 1.0]]), "finite numbers"),
        (np.array([["a", "b"]]), "finite numbers"),
    ],
)
def test_what_is_no_classification_gets_a_sentence(output, told):
    with pytest.raises(UserError, match=told):
        classified(output)


def test_torch_modules_and_functions_are_called_by_their_convention():
    halves = find_model(Halves().eval(), "classify", Preparation(), "cpu")
    assert halves.names == {"left": 0, "right": 1}
    assert halves.found(square(10, 20)).classes.tolist() == [0]
    assert halves.found(square(90, 20)).classes.tolist() == [1]
    detector = find_model(find_square, "detect", Preparation(), "cpu")
    assert detector.fingerprint is None
    assert_array_equal(detector.found(square(10, 20)).boxes, [[10, 20, 34, 44]])
    assert halves.fingerprint == Model(Halves().eval(), "classify", Preparation()).fingerprint
    assert halves.fingerprint != Model(Halves().eval(), "classify", Preparation(8)).fingerprint


def test_torchscript_is_loaded_from_its_file(tmp_path):
    path = tmp_path / "halves.pt"
    torch.jit.script(Halves().eval()).save(path)
    with pytest.raises(UserError, match=r"task='classify' or task='detect' for .*halves.pt"):
        find_model(path, None, Preparation(), "cpu")
    model = find_model(path, "classify", Preparation(), "cpu")
    assert model.found(square(90, 20)).classes.tolist() == [1]
    assert len(model.fingerprint) == 64


def test_an_onnx_classifier_is_asked_in_its_own_size(tmp_path):
    path = onnx_file(tmp_path / "c.onnx", (1, 3, 16, 16), [[0.0, 3.0, 1.0]])
    model = find_model(path, None, Preparation(), "cpu")
    assert model.task == "classify"
    assert model.found(square(10, 10)).classes.tolist() == [1]
    copied = pickle.loads(pickle.dumps(model))
    assert copied.found(square(10, 10)).classes.tolist() == [1]
    assert copied.fingerprint == model.fingerprint


HEAD = np.zeros((1, 6, 40), np.float32)  # x y width height, two classes
HEAD[0, :, 0] = 32, 24, 16, 8, 0.1, 0.9
HEAD[0, :, 1] = 33, 24, 16, 8, 0.1, 0.8  # the same object
HEAD[0, :, 2] = 10, 40, 4, 4, 0.6, 0.1
YOLO5 = np.zeros((1, 40, 7), np.float32)
YOLO5[0, :, :4], YOLO5[0, :, 4], YOLO5[0, :, 5:] = HEAD[0, :4].T, 1.0, HEAD[0, 4:].T
ENDED = np.zeros((1, 300, 6), np.float32)
ENDED[0, 0], ENDED[0, 1] = (24, 20, 40, 28, 0.9, 1), (8, 38, 12, 42, 0.6, 0)


@pytest.mark.parametrize("head", [HEAD, YOLO5, ENDED], ids=["v8", "v5", "ended"])
@pytest.mark.parametrize("kind", [1, 2], ids=["floats", "uint8"])
def test_yolos_heads_are_decoded_and_moved_back(tmp_path, head, kind):
    names = [("names", "{0: 'car', 1: 'person'}")]
    path = onnx_file(tmp_path / "d.onnx", (1, 3, 64, 64), head, kind, names)
    model = OnnxModel(path, Preparation())
    assert (model.task, model.names) == ("detect", {"car": 0, "person": 1})
    # 128 x 96 fits into 64 x 64 by a half, with 8 px above and below
    found = model.found(square(10, 10))
    order = np.argsort(-found.scores)
    assert found.classes[order].tolist() == [1, 0]
    assert_allclose(found.boxes[order], [[48, 24, 80, 40], [16, 60, 24, 68]])
    assert_allclose(found.scores[order], [0.9, 0.6], atol=1e-6)


def test_three_outputs_are_boxes_labels_and_scores():
    boxes, labels, scores = np.ones((2, 4)), np.array([1, 2]), np.array([0.5, 0.4])
    for given in ((boxes, labels, scores), (scores, boxes, labels)):
        told = decoded(given)
        assert_array_equal(told[0], boxes)
        assert_array_equal(told[1], labels)
        assert_array_equal(told[2], scores)
    with pytest.raises(UserError, match="one head of YOLO's, got outputs of"):
        decoded([np.zeros((1, 3, 8, 8))])


def test_what_is_no_model_gets_a_sentence(tmp_path):
    def find(agent, task=None, device="cpu"):
        return find_model(agent, task, Preparation(), device)

    with pytest.raises(UserError, match=r"an agent among coco-centernet, .* got 'yolo'"):
        find("yolo")
    with pytest.raises(UserError, match="task='classify' or task='detect' for a network"):
        find(Halves().eval())
    with pytest.raises(UserError, match=r"evaluation mode, .*model.eval\(\)"):
        find(Halves(), "classify")
    with pytest.raises(UserError, match="a network that can be called, got int"):
        find(3, "classify")
    with pytest.raises(UserError, match="task to be one of classify, detect"):
        find(Halves().eval(), "segment")
    (tmp_path / "bad.onnx").write_bytes(b"none")
    with pytest.raises(UserError, match="an ONNX model in"):
        find(tmp_path / "bad.onnx")
    nan = Halves().eval()
    nan.scale.data.fill_(torch.nan)
    with pytest.raises(UserError, match="weights are finite"):
        find(nan, "classify")
    if not torch.cuda.is_available():
        with pytest.raises(UserError, match="a device that is here, got 'cuda'"):
            find(Halves().eval(), "classify", "cuda")
    one = find(nn.Flatten().eval(), "classify")
    with pytest.raises(UserError, match=r"GPU|device"):
        find(Halves().eval(), "classify", "no device")
    assert len(one.found(square(1, 1)).probabilities) == 96 * 128 * 3


def test_answers_that_break_the_convention_are_told():
    def without_scores(images):
        return [{"boxes": torch.zeros(0, 4), "labels": torch.zeros(0)} for _ in images]

    with pytest.raises(UserError, match="scores from the detector"):
        find_model(without_scores, "detect", Preparation(), "cpu").found(square(1, 1))

    def broken(_):
        raise RuntimeError("no such size")

    with pytest.raises(UserError, match=r"an answer of the model to an image of .* no such size"):
        find_model(broken, "detect", Preparation(), "cpu").found(square(1, 1))


def test_weights_beside_an_onnx_file_belong_to_it(tmp_path):
    onnx = pytest.importorskip("onnx")
    path = onnx_file(tmp_path / "c.onnx", (1, 3, 16, 16), [[0.0, 3.0, 1.0]])
    whole = find_model(path, None, Preparation(), "cpu")
    beside = {"save_as_external_data": True, "location": "d.onnx.data", "size_threshold": 0}
    onnx.save_model(onnx.load(path), tmp_path / "d.onnx", **beside)
    model = pickle.loads(pickle.dumps(find_model(tmp_path / "d.onnx", None, Preparation(), "cpu")))
    assert model.found(square(10, 10)).classes.tolist() == [1]
    assert model.fingerprint != whole.fingerprint
