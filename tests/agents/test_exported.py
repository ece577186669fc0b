from pathlib import Path

import numpy as np
import pytest
from gymnasium import spaces

from sada_gym.agents.exported import OnnxNetwork, takes_channels_first
from sada_gym.errors import Notice

FILE = Path("net.onnx")
FREE = "h", "w"


def picture(*shape):
    return spaces.Box(0, 255, shape, np.uint8)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("seen", "wanted", "first"),
    [
        ((8, 6, 3), (3, 8, 6), True),
        ((8, 6, 3), (3, *FREE), True),
        ((8, 6, 3), (3, None, None), True),
        ((8, 6, 3), ("c", 8, 6), True),
        ((8, 6, 3), (8, 6, 3), False),
        ((8, 6, 3), (*FREE, 3), False),
        ((8, 6, 3), (1, *FREE), False),
        ((3, 8, 6), (3, *FREE), False),
        ((8, 6), (3, *FREE), False),
        ((4,), (4,), False),
        ((), (), False),
    ],
)
def test_pictures_are_turned_where_only_that_fits(seen, wanted, first):
    assert takes_channels_first(picture(*seen), ("n", *wanted), "x", FILE) is first


@pytest.mark.parametrize(
    ("seen", "wanted"), [((3, 3, 3), (3, 3, 3)), ((3, 6, 3), (3, *FREE)), ((8, 6, 3), ("c", *FREE))]
)
def test_pictures_that_fit_both_ways_are_told(seen, wanted):
    with pytest.warns(Notice, match=r"'x' of net.onnx.* as they are and with their channels"):
        assert not takes_channels_first(picture(*seen), ("n", *wanted), "x", FILE)


@pytest.mark.parametrize("sizes", [(8, 6), FREE])
def test_an_onnx_network_of_pictures_of_any_size_sees_the_channels_in_front(sizes, tmp_path):
    onnx = pytest.importorskip("onnx", reason="onnx is not installed")
    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    from onnx import helper

    size = helper.make_tensor_value_info
    graph = helper.make_graph(
        [
            helper.make_node("Cast", ["x"], ["f"], to=onnx.TensorProto.FLOAT),
            helper.make_node("GlobalAveragePool", ["f"], ["pool"]),  # a mean for each channel
            helper.make_node("Flatten", ["pool"], ["y"]),
        ],
        "graph",
        [size("x", onnx.TensorProto.UINT8, ["n", 3, *sizes])],
        [size("y", onnx.TensorProto.FLOAT, ["n", 3])],
    )
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=9), tmp_path / FILE)
    network = OnnxNetwork(tmp_path / FILE, picture(8, 6, 3), spaces.Discrete(3))
    brightest = np.array([2, 0, 1])
    seen = np.eye(3, dtype=np.uint8)[brightest][:, None, None].repeat(8, 1).repeat(6, 2)
    actions, _ = network.predict(seen, deterministic=True)
    np.testing.assert_array_equal(actions, brightest)
