"""A small graph, converted, gives what its nodes give one by one."""

import base64
import json
import math

import numpy as np
import pytest
import torch
from plain_graph import PlainGraph
from safetensors.torch import load

from sada_gym.envs.detection.agent.graph import convert
from sada_gym.envs.detection.agent.steps import StepNetwork
from sada_gym.errors import FileError


class SmallGraph:
    """Writes nodes and constants as TensorFlow.js does, with weights in 16 bits."""

    def __init__(self):
        self.nodes, self.entries, self.content = [], [], b""
        self.rng = np.random.default_rng(0)
        self.node("image", "Placeholder")

    def node(self, name, op, *inputs, **attributes):
        self.nodes.append({"name": name, "op": op, "input": inputs, "attr": attributes})
        return name

    def constant(self, name, values, dtype="float32"):
        values = np.asarray(values, np.float16 if dtype == "float32" else dtype)
        entry = {"name": name, "dtype": dtype, "shape": values.shape}
        if dtype == "float32":
            entry["quantization"] = {"dtype": "float16", "original_dtype": "float32"}
        self.entries.append(entry)
        self.content += values.tobytes()
        return self.node(name, "Const")

    def convolution(self, name, seen, shape, stride=1, *, fused=("BiasAdd",), padding="SAME"):
        depthwise = shape[-1] == 1
        weights = self.rng.normal(0, 1 / math.sqrt(math.prod(shape[:3])), shape)
        inputs = [seen, self.constant(f"{name}/w", 2 * weights)]
        if "BiasAdd" in fused:
            outputs = shape[2] if depthwise else shape[3]
            inputs.append(self.constant(f"{name}/b", self.rng.normal(0, 1, outputs)))
        op = "FusedDepthwiseConv2dNative" if depthwise else "_FusedConv2D"
        if not fused:
            op = "DepthwiseConv2dNative" if depthwise else "Conv2D"
        names = {"fused_ops": {"list": {"s": [text(each) for each in fused]}}} if fused else {}
        strides = {"list": {"i": ["1", str(stride), str(stride), "1"]}}
        return self.node(name, op, *inputs, strides=strides, padding={"s": text(padding)}, **names)

    def hard(self, name, seen, *, swish):
        """Add hard-swish or hard-sigmoid as such graphs have them, with a sixth in 16 bits."""
        three, sixth = self.constant(f"{name}/3", 3), self.constant(f"{name}/6", 1 / 6)
        clipped = self.node(f"{name}/clip", "Relu6", self.node(f"{name}/add", "Add", seen, three))
        if not swish:
            return self.node(name, "Mul", sixth, clipped)
        return self.node(name, "Mul", self.node(f"{name}/mul", "Mul", sixth, seen), clipped)

    def files(self):
        model = {
            "modelTopology": {"node": self.nodes},
            "weightsManifest": [{"weights": self.entries}],
        }
        return json.dumps(model).encode(), self.content


def text(plain):
    return base64.b64encode(plain.encode()).decode()


@pytest.fixture
def graph():
    """All kinds of nodes: strides, gates, skips, branches that join at another size."""
    g = SmallGraph()
    x = g.hard("swish", g.convolution("first", "image", (3, 3, 3, 8), 2), swish=True)
    y = g.convolution("deep", x, (5, 5, 8, 1), fused=("BiasAdd", "Relu6"))
    y = g.node("skip", "Add", g.convolution("point", y, (1, 1, 8, 8)), x)  # x has a factor
    small = g.convolution("down", y, (5, 5, 8, 1), 2, fused=("BiasAdd", "Relu"))
    axes = g.constant("axes", [1, 2], "int32")
    gate = g.node("mean", "Mean", small, axes)
    gate = g.convolution("squeeze", gate, (1, 1, 8, 4), fused=("BiasAdd", "Relu"))
    gate = g.hard("gate", g.convolution("excite", gate, (1, 1, 4, 8)), swish=False)
    small = g.node("gated", "Mul", gate, small)
    small = g.convolution("branch", small, (1, 1, 8, 6), padding="VALID")
    size = g.constant("size", [16, 24], "int32")
    large = g.node("resized", "ResizeBilinear", small, size)
    axis = g.constant("axis", 3, "int32")
    joined = g.node("relu", "Relu", g.node("joined", "ConcatV2", y, large, axis))
    whole = g.convolution("gate2", g.node("mean2", "Mean", joined, axes), (1, 1, 14, 14), fused=())
    g.node("out1", "Mul", joined, g.node("sigmoid", "Sigmoid", whole))
    head = g.convolution("head", "out1", (3, 3, 14, 1), fused=())
    head = g.convolution("head/point", head, (1, 1, 14, 4))
    g.node("out2", "Mul", head, g.constant("sixteen", 16))
    g.node("out3", "Identity", head)
    return g


def network(graph, *outputs):
    content = convert(*graph.files(), outputs)
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])["__metadata__"]["architecture"]
    return StepNetwork(json.loads(header), load(content))


def test_the_converted_graph_equals_the_nodes(graph, tmp_path):
    for ending, content in zip(("json", "bin"), graph.files(), strict=True):
        (tmp_path / f"small.{ending}").write_bytes(content)
    outputs = ("out1", "out2", "out3")
    plain, converted = PlainGraph(tmp_path, "small"), network(graph, *outputs)
    assert len(converted.program["steps"]) < len(graph.nodes) / 2
    for seed in range(3):
        image = 3 * torch.randn(1, 32, 48, 3, generator=torch.Generator().manual_seed(seed))
        before = image.clone()
        output = converted(image.permute(0, 3, 1, 2).flip(2, 3))
        for answer, expected in zip(output, plain(image, *outputs), strict=True):
            turned = answer.flip(2, 3).permute(0, 2, 3, 1)
            assert expected.std() > 0.1
            torch.testing.assert_close(turned, expected, atol=1e-4, rtol=1e-5)
        assert torch.equal(image, before)


def test_the_conversion_is_deterministic(graph):
    assert convert(*graph.files(), ["out2"]) == convert(*graph.files(), ["out2"])


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        (lambda g: g.node("end", "Softmax", "out2"), "got Softmax as its node end"),
        (lambda g: g.convolution("end", "out2", (3, 3, 4, 2), 3), "stride of 1 or 2, got end"),
        (lambda g: g.convolution("end", "out2", (2, 2, 4, 2)), "square kernels .* got end"),
        (lambda g: g.convolution("end", "out2", (3, 3, 4, 2), padding="VALID"), "edges, got end"),
        (lambda g: g.node("end", "Relu", "out2"), "Expected out2 without a factor"),
        (lambda g: setattr(g, "content", g.content[:-2]), "bytes of weights, got"),
    ],
)
def test_other_graphs_are_refused(graph, change, wrong):
    change(graph)
    with pytest.raises(FileError, match=wrong):
        convert(*graph.files(), [graph.nodes[-1]["name"]])
