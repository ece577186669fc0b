"""Files as agents: where they are looked for, what lies beside them, ONNX and TorchScript."""

from __future__ import annotations

import pickle
import sys

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn
from wrapped_toys import Reach, cart_pole, pendulum, reach, worlds

from sada_gym.envs.wrapped.toml import read_application
from sada_gym.testing.purity import assert_pure

TOML = """environment = "CartPole-v1"
agent = "{agent}"
score = ["length", 500]
fooling_threshold = 0.5
{more}
[parameters]
gravity = [5.0, 20.0]
"""


@pytest.fixture(scope="module")
def model():
    return PPO("MlpPolicy", "CartPole-v1", seed=1, device="cpu")


def test_the_home_folder_and_a_missing_ending_are_understood(model, tmp_path, monkeypatch):
    home = tmp_path / "a home"
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("USERPROFILE", str(home))
    model.save(home / "ag.v2.zip")
    monkeypatch.chdir(home)
    for agent in ("~/ag.v2.zip", "~/ag.v2", "ag.v2", home / "ag.v2"):
        assert cart_pole(agent=agent, agent_id=None).agent_name == "ag.v2"
    for text in ("ag.v2", "~/ag.v2", "~/ag.v2.zip"):
        (home / "pole.toml").write_text(TOML.format(agent=text, more=""))
        assert read_application(home / "pole.toml").fingerprint
    with pytest.raises(ValueError, match=r"SB3 zip as the agent, got other: no such file"):
        cart_pole(agent="other")


PLACES = (
    "vecnormalize.pkl",
    "model_vecnormalize_64_steps.pkl",
    "agent/vecnormalize.pkl",
    "Pendulum-v1/vecnormalize.pkl",
)


@pytest.mark.parametrize("place", PLACES)
def test_statistics_beside_a_zip_are_not_overlooked(place, tmp_path):
    vec = VecNormalize(make_vec_env("Pendulum-v1", 1, seed=0))
    agent = tmp_path / "agent.zip"
    PPO("MlpPolicy", vec, seed=0, device="cpu").save(agent)
    (tmp_path / "model_replay_buffer_64_steps.pkl").write_bytes(pickle.dumps([1]))
    (tmp_path / "another run").mkdir()
    vec.save(str(tmp_path / "another run" / "vecnormalize.pkl"))
    assert pendulum(agent=agent)
    file = tmp_path / place
    file.parent.mkdir(exist_ok=True)
    vec.save(str(file))
    with pytest.raises(ValueError, match=rf"VecNormalize in .*{place}.*vec_normalize=False"):
        pendulum(agent=agent)
    mu, seeds = np.zeros((1, 2)), [0]
    bare = pendulum(agent=agent, vec_normalize=False).evaluate(mu, seeds).score
    known = pendulum(agent=agent, vec_normalize=file, allow_pickle=True)
    assert known.evaluate(mu, seeds).score.shape == bare.shape
    with pytest.raises(ValueError, match=r"the path of its file, got True\. Pass False if the"):
        pendulum(agent=agent, vec_normalize=True)


def test_a_toml_file_says_that_there_were_no_statistics(model, tmp_path):
    model.save(tmp_path / "agent.zip")
    (tmp_path / "other.pickle").write_bytes(b"VecNormalize")
    file = tmp_path / "pole.toml"
    file.write_text(TOML.format(agent="agent.zip", more=""))
    with pytest.raises(ValueError, match="vec_normalize=False if the agent needs none"):
        read_application(file)
    file.write_text(TOML.format(agent="agent.zip", more="vec_normalize = false"))
    assert read_application(file).fingerprint
    file.write_text(TOML.format(agent="agent.zip", more="vec_normalize = 3"))
    with pytest.raises(ValueError, match="the path of a file in quotes, or false, got 3"):
        read_application(file)


class Network(nn.Module):
    """The policy of an SB3 model, as its documentation exports it."""

    def __init__(self, policy):
        super().__init__()
        self.extractor, self.action_net = policy.mlp_extractor.policy_net, policy.action_net

    def forward(self, observation):
        return self.action_net(self.extractor(observation))


def scores(application):
    return application.evaluate(*worlds(application)).score


@pytest.mark.parametrize("ending", [".pt", ".ts", ".torchscript"])
def test_torchscript_acts_like_the_model_that_it_was_made_of(ending, model, tmp_path):
    file = tmp_path / f"pole{ending}"
    torch.jit.trace(Network(model.policy), torch.zeros(1, 4)).save(str(file))
    application = cart_pole(agent=file, agent_id=None)
    assert application.fingerprint != cart_pole(agent=model, agent_id=None).fingerprint
    assert (scores(application) == scores(cart_pole(agent=model))).all()
    assert_pure(application, n=5, sizes=(1, 3))


def test_a_scripted_module_takes_the_parts_of_a_dictionary_by_name(tmp_path):
    class Walks(nn.Module):
        def forward(self, goal: torch.Tensor, position: torch.Tensor):
            return (position[:, 0] < goal).long(), goal

    torch.jit.script(Walks()).save(str(tmp_path / "walks.pt"))
    application = reach(Reach, agent=tmp_path / "walks.pt")
    assert (scores(application) == scores(reach())).all()

    class Other(nn.Module):
        def forward(self, place: torch.Tensor):
            return place

    torch.jit.script(Other()).save(str(tmp_path / "other.pt"))
    with pytest.raises(ValueError, match=r"the inputs goal, position in .*other.pt, got place"):
        reach(Reach, agent=tmp_path / "other.pt")


@pytest.mark.parametrize("ending", [".pt", ".onnx"])
def test_a_file_of_another_kind_gets_a_sentence(ending, model, tmp_path):
    if ending == ".onnx":
        pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    torch.save(model.policy.state_dict(), tmp_path / f"pole{ending}")
    with pytest.raises(ValueError, match=r"Expected an? (TorchScript module|ONNX model) in .*pole"):
        cart_pole(agent=tmp_path / f"pole{ending}")


def onnx_file(path, inputs, nodes, outputs, weights=()):
    """Write an ONNX file: names with shapes, nodes as (kind, inputs, output)."""
    onnx = pytest.importorskip("onnx", reason="onnx is not installed")
    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    from onnx import helper, numpy_helper

    def values(named):
        return [helper.make_tensor_value_info(name, *about) for name, about in named.items()]

    graph = helper.make_graph(
        [helper.make_node(kind, given, [out], **more) for kind, given, out, more in nodes],
        "agent",
        values(inputs),
        values(outputs),
        [numpy_helper.from_array(value, name) for name, value in weights],
    )
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=9), path)
    return path


def linear(path, rows, weight, width):
    return onnx_file(
        path,
        {"seen": (1, [rows, len(weight)])},
        [("MatMul", ["seen", "weight"], "actions", {})],
        {"actions": (1, [rows, width])},
        [("weight", np.asarray(weight, np.float32))],
    )


@pytest.mark.parametrize("rows", ["batch", 1, 5])
def test_onnx_acts_like_the_function_that_it_computes(rows, tmp_path):
    weight = [[0, 0], [0, 0], [-1, 1], [-1, 1]]
    application = cart_pole(agent=linear(tmp_path / "p.onnx", rows, weight, 2), agent_id=None)
    assert application.fingerprint
    assert (scores(application) == scores(cart_pole())).all()
    assert_pure(application, n=5, sizes=(1, 3))
    with pytest.raises(ValueError, match="an exported network draws no actions"):
        cart_pole(agent=tmp_path / "p.onnx", deterministic=False)


def test_onnx_gives_box_actions_as_they_are(tmp_path):
    file = linear(tmp_path / "swing.ONNX", "n", [[0], [-10], [-2]], 1)
    given, expected = scores(pendulum(agent=file)), scores(pendulum())
    np.testing.assert_allclose(given, expected, atol=0.05)


def test_an_onnx_network_for_another_environment_gets_a_sentence(tmp_path):
    file = linear(tmp_path / "other.onnx", "n", np.zeros((7, 2)), 2)
    with pytest.raises(ValueError, match=r"Expected actions for observations .* from .*other.onnx"):
        cart_pole(agent=file)
    file = linear(tmp_path / "wide.onnx", "n", np.zeros((4, 3)), 3)
    with pytest.raises(ValueError, match=r"a number for each choice, got shape \(16, 3\)"):
        cart_pole(agent=file)


def test_torchs_own_export_with_weights_beside_it(model, tmp_path):
    pytest.importorskip("onnxscript", reason="onnxscript is not installed, torch.onnx needs it")
    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    file = tmp_path / "pole.onnx"
    batch = torch.export.Dim("batch", min=1, max=64)
    torch.onnx.export(
        Network(model.policy).eval(),
        (torch.zeros(2, 4),),
        file,
        dynamic_shapes=({0: batch},),
        external_data=True,
    )
    assert (tmp_path / "pole.onnx.data").is_file()
    application = cart_pole(agent=file, agent_id=None)
    assert (scores(application) == scores(cart_pole(agent=model))).all()


def test_onnxruntime_may_be_missing(tmp_path, monkeypatch):
    (tmp_path / "pole.onnx").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ValueError, match=r"onnxruntime to be installed .* '\.\[onnx\]'"):
        cart_pole(agent=tmp_path / "pole.onnx")
