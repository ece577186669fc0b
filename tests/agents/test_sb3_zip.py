"""SB3's zip files are loaded without unpickling, act like SB3's own, and never run code."""

import base64
import io
import json
import pickle
import sys
import zipfile

import gymnasium as gym
import numpy as np
import pytest
import stable_baselines3
import torch
from gymnasium import spaces
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecFrameStack,
    VecNormalize,
    VecTransposeImage,
)
from stable_baselines3.dqn.policies import DQNPolicy
from torch import nn

from sada_gym import agents
from sada_gym.agents import sb3_zip
from sada_gym.agents.sb3_zip import load_sb3
from sada_gym.errors import FileError, UserError

VECTOR = spaces.Box(-1.0, 1.0, (4,), np.float32)
PICTURE = spaces.Box(0, 255, (36, 40, 3), np.uint8)
BOTH = spaces.Dict({"speed": spaces.Box(0.0, 9.0, (2,), np.float32), "camera": PICTURE})
DISCRETE = spaces.Discrete(3)
TORQUES = spaces.Box(np.float32([-20.0, -10.1]), np.float32([20.0, 30.3]))


class Fake(gym.Env):
    """Has the spaces that a test asks for."""

    def __init__(self, observation_space=VECTOR, action_space=DISCRETE):
        self.observation_space, self.action_space = observation_space, action_space

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, True, False, {}


class OwnPolicy(ActorCriticPolicy):
    """A policy that SB3 does not know."""


class Payload:
    """Writes a file when it is unpickled."""

    def __init__(self, marker):
        self.marker = str(marker)

    def __reduce__(self):
        return open, (self.marker, "w")


def new_model(kind, policy="MlpPolicy", env=None, **more):
    if kind not in (PPO, A2C):
        more.setdefault("buffer_size", 4)
    model = kind(policy, env or Fake(), device="cpu", seed=4, **more)
    with torch.no_grad():
        for weight in model.policy.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
    return model


def samples(space, count=20):
    space.seed(0)
    drawn = [space.sample() for _ in range(count)]
    if isinstance(space, spaces.Dict):
        return {key: np.stack([sample[key] for sample in drawn]) for key in space}
    return np.stack(drawn)


def outputs(policy, seen):
    """Return what a network says before it chooses an action, or the action if that is all."""
    observation, _ = policy.obs_to_tensor(seen)
    with torch.no_grad():
        if isinstance(policy, DQNPolicy):
            return policy.q_net(observation).numpy()
        if isinstance(policy.action_space, spaces.Discrete):
            return policy.get_distribution(observation).distribution.logits.numpy()
    return policy.predict(seen, deterministic=True)[0]


def assert_alike(loaded, path, kind):
    """Compare with the model that SB3 loads: same actions to the last bit, same fingerprint."""
    reference = kind.load(path, device="cpu")
    seen = samples(reference.observation_space)
    expected, _ = reference.predict(seen, deterministic=True)
    action, _ = loaded.predict(seen, deterministic=True)
    np.testing.assert_array_equal(action, expected)
    assert action.dtype == expected.dtype
    answers = outputs(reference.policy, seen)
    assert len(np.unique(answers, axis=0)) > 10  # one that ignores what it sees proves nothing
    np.testing.assert_array_equal(outputs(loaded.policy, seen), answers)
    assert agents.fingerprint(loaded.policy) == agents.fingerprint(reference.policy)
    assert loaded.observation_space == reference.observation_space
    assert loaded.action_space == reference.action_space


@pytest.fixture
def path(tmp_path):
    """A PPO model for vectors and three actions."""
    new_model(PPO).save(tmp_path / "model.zip")
    return tmp_path / "model.zip"


def rewrite(path, **parts):
    """Replace parts of a zip file; None leaves one out; a function changes the data."""
    with zipfile.ZipFile(path) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    for name, part in parts.items():
        name = name.replace("_pth", ".pth")
        if callable(part):
            data = json.loads(content["data"])
            part(data)
            part = json.dumps(data)
        content[name] = part
    with zipfile.ZipFile(path, "w") as archive:
        for name, part in content.items():
            if part is not None:
                archive.writestr(name, part)


@pytest.mark.parametrize("policy", ["MlpPolicy", "CnnPolicy", "MultiInputPolicy"])
@pytest.mark.parametrize(
    ("kind", "action_space"),
    [
        (PPO, DISCRETE),
        (PPO, TORQUES),
        (A2C, DISCRETE),
        (DQN, DISCRETE),
        (SAC, TORQUES),
        (TD3, TORQUES),
        (DDPG, TORQUES),
    ],
)
def test_actions_are_those_of_the_model_that_sb3_loads(kind, action_space, policy, tmp_path):
    space = {"MlpPolicy": VECTOR, "CnnPolicy": PICTURE, "MultiInputPolicy": BOTH}[policy]
    path = tmp_path / "model.zip"
    new_model(kind, policy, Fake(space, action_space)).save(path)
    loaded = load_sb3(path, space, action_space)
    assert type(loaded) is (TD3 if kind is DDPG else kind)
    assert_alike(loaded, path, kind)


@pytest.mark.parametrize(
    ("kind", "action_space", "arguments"),
    [
        (PPO, DISCRETE, {"activation_fn": nn.ReLU, "net_arch": {"pi": [8], "vf": [7, 6]}}),
        (PPO, TORQUES, {"net_arch": [8], "squash_output": False, "log_std_init": -1.0}),
        (SAC, TORQUES, {"activation_fn": nn.ELU, "net_arch": {"pi": [9], "qf": [8]}}),
        (DQN, DISCRETE, {"features_extractor_class": FlattenExtractor, "net_arch": []}),
        (TD3, TORQUES, {"optimizer_class": torch.optim.SGD, "n_critics": 3}),
        (A2C, DISCRETE, {"share_features_extractor": False, "activation_fn": nn.SiLU}),
    ],
)
def test_policy_arguments_are_read_from_the_words(kind, action_space, arguments, tmp_path):
    path = tmp_path / "model.zip"
    new_model(kind, env=Fake(action_space=action_space), policy_kwargs=arguments).save(path)
    assert_alike(load_sb3(path, VECTOR, action_space), path, kind)


@pytest.mark.parametrize("kind", [PPO, A2C, SAC])
@pytest.mark.parametrize("squash", [False, True])
def test_models_with_gsde(kind, squash, tmp_path):
    path = tmp_path / "model.zip"
    arguments = {"squash_output": squash} if kind is not SAC else {}
    env = Fake(action_space=TORQUES)
    new_model(kind, env=env, use_sde=True, policy_kwargs=arguments).save(path)
    loaded = load_sb3(path, VECTOR, TORQUES)
    assert loaded.use_sde
    assert_alike(loaded, path, kind)


@pytest.mark.parametrize(
    ("policy", "space"), [("MlpPolicy", VECTOR), ("CnnPolicy", PICTURE), ("MultiInputPolicy", BOTH)]
)
def test_stacked_frames_are_seen_in_the_file(policy, space, tmp_path):
    path = tmp_path / "model.zip"
    env = VecFrameStack(DummyVecEnv([lambda: Fake(space)]), 3)
    new_model(PPO, policy, env).save(path)
    assert_alike(load_sb3(path, space, DISCRETE), path, PPO)


def test_agents_of_normalised_vectors_load_and_act_on_what_they_get(tmp_path):
    path = tmp_path / "model.zip"
    new_model(PPO, env=VecNormalize(DummyVecEnv([Fake]))).save(path)
    assert_alike(load_sb3(path, VECTOR, DISCRETE), path, PPO)


def test_agents_of_normalised_pictures_need_trust(tmp_path):
    path = tmp_path / "model.zip"
    env = VecNormalize(VecTransposeImage(DummyVecEnv([lambda: Fake(PICTURE)])))
    new_model(PPO, "CnnPolicy", env, policy_kwargs={"normalize_images": False}).save(path)
    with pytest.raises(UserError, match=r"of float32.*VecNormalize needs allow_pickle=True"):
        load_sb3(path, PICTURE, DISCRETE)
    assert (
        load_sb3(path, PICTURE, DISCRETE, allow_pickle=True).observation_space.dtype == np.float32
    )


def test_a_file_of_an_old_sb3_has_shared_extractors_once_and_layers_in_a_list(tmp_path):
    path = tmp_path / "model.zip"
    arguments = {"net_arch": {"pi": [8], "vf": [8]}}
    new_model(PPO, "CnnPolicy", Fake(PICTURE), policy_kwargs=arguments).save(path)
    assert_alike(load_sb3(path, PICTURE, DISCRETE), path, PPO)
    with zipfile.ZipFile(path) as archive:
        weights = torch.load(archive.open("policy.pth"), weights_only=True)
    before = agents.fingerprint(load_sb3(path, PICTURE, DISCRETE).policy)
    old = {key: value for key, value in weights.items() if key[:3] not in ("pi_", "vf_")}
    assert len(old) < len(weights)
    buffer = io.BytesIO()
    torch.save(old, buffer)
    layers = {"net_arch": [{"pi": [8], "vf": [8]}]}
    rewrite(path, policy_pth=buffer.getvalue(), data=lambda data: data.update(policy_kwargs=layers))
    assert agents.fingerprint(load_sb3(path, PICTURE, DISCRETE).policy) == before


def test_loading_leaves_global_generators_and_the_spaces_alone(tmp_path):
    path = tmp_path / "model.zip"
    new_model(PPO, "CnnPolicy", Fake(PICTURE)).save(path)
    space = spaces.Box(0, 255, PICTURE.shape, np.uint8, seed=3)
    torch.manual_seed(5)
    state = torch.random.get_rng_state()
    loaded = load_sb3(path, space, DISCRETE)
    assert torch.equal(torch.random.get_rng_state(), state)
    fresh = spaces.Box(0, 255, PICTURE.shape, np.uint8, seed=3)
    np.testing.assert_array_equal(space.sample(), fresh.sample())
    assert not loaded.policy.training


def test_a_loaded_model_can_be_sent_to_another_process(path):
    sent = pickle.loads(pickle.dumps(load_sb3(path, VECTOR, DISCRETE)))
    assert_alike(sent, path, PPO)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"activation_fn": lambda: nn.LeakyReLU(0.2)}, "activation_fn=<function"),
        ({"features_extractor_kwargs": {"activation": nn.ReLU}, "net_arch": [8]}, "features_ext"),
    ],
)
def test_arguments_that_only_a_pickle_knows_are_never_guessed(arguments, named, path):
    def put(data):
        stored = {":type:": "<class 'dict'>", ":serialized:": "gASV"}
        stored |= {
            key: value if key == "net_arch" else str(value) for key, value in arguments.items()
        }
        data["policy_kwargs"] = stored

    rewrite(path, data=put)
    with pytest.raises(UserError, match=rf"{named}.*without unpickling.*allow_pickle=True"):
        load_sb3(path, VECTOR, DISCRETE)


def test_trust_unpickles_what_only_a_pickle_knows(tmp_path):
    path = tmp_path / "model.zip"
    arguments = {"activation_fn": lambda: nn.LeakyReLU(0.2)}
    new_model(PPO, policy_kwargs=arguments).save(path)
    with pytest.raises(UserError, match="activation_fn=<function"):
        load_sb3(path, VECTOR, DISCRETE)
    loaded = load_sb3(path, VECTOR, DISCRETE, allow_pickle=True)
    assert loaded.predict(samples(VECTOR), deterministic=True)[0].shape == (20,)


def test_a_policy_class_of_ones_own_needs_trust(tmp_path):
    path = tmp_path / "model.zip"
    new_model(PPO, OwnPolicy).save(path)
    with pytest.raises(
        UserError, match=r"a policy of SB3's.*without unpickling.*allow_pickle=True"
    ):
        load_sb3(path, VECTOR, DISCRETE)
    assert type(load_sb3(path, VECTOR, DISCRETE, allow_pickle=True).policy).__name__ == "OwnPolicy"


def test_trust_says_what_cannot_be_unpickled(path):
    broken = {":type:": "<class 'dict'>", ":serialized:": "AAAA"}
    rewrite(path, data=lambda data: data.update(policy_kwargs=broken))
    with pytest.raises(FileError, match=r"that can be unpickled in .*, got UnpicklingError"):
        load_sb3(path, VECTOR, DISCRETE, allow_pickle=True)


@pytest.mark.parametrize("module", ["sb3_contrib.tqc.policies", "sb3_contrib.qrdqn.policies"])
def test_models_of_sb3_contrib_need_it(module, path, monkeypatch):
    words = pickle.dumps(len).replace(
        b"\x8c\x08builtins", bytes([0x8C, len(module)]) + module.encode()
    )
    entry = {":serialized:": base64.b64encode(words).decode()}
    rewrite(path, data=lambda data: data.update(policy_class=entry))
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    with pytest.raises(UserError, match=r"sb3-contrib to be installed.* '\.\[contrib\]'"):
        load_sb3(path, VECTOR, DISCRETE)


CONTRIB = [
    ("TQC", "MlpPolicy", TORQUES, {"n_quantiles": 7, "net_arch": [8]}),
    ("QRDQN", "MlpPolicy", DISCRETE, {"n_quantiles": 7}),
    ("ARS", "LinearPolicy", DISCRETE, {}),
    ("TRPO", "MlpPolicy", TORQUES, {"activation_fn": nn.ReLU}),
    ("CrossQ", "MlpPolicy", TORQUES, {"net_arch": [8]}),
    ("MaskablePPO", "MlpPolicy", DISCRETE, {}),
    ("RecurrentPPO", "MlpLstmPolicy", DISCRETE, {"lstm_hidden_size": 8, "n_lstm_layers": 2}),
]


@pytest.mark.parametrize(("name", "policy", "actions", "kwargs"), CONTRIB)
def test_models_of_sb3_contrib_are_loaded_without_unpickling(
    name, policy, actions, kwargs, tmp_path
):
    contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")
    env = Fake(VECTOR, actions)
    model = getattr(contrib, name)(policy, env, policy_kwargs=kwargs, seed=0, device="cpu")
    model.save(tmp_path / "model.zip")
    loaded = load_sb3(tmp_path / "model.zip", VECTOR, actions)
    assert type(loaded) is type(model)
    seen = samples(VECTOR)
    expected = model.predict(seen, deterministic=True)[0]
    assert (loaded.predict(seen, deterministic=True)[0] == expected).all()


def test_another_algorithm_is_refused(path):
    def strip(data):
        for key in sb3_zip._ALGORITHMS:
            data.pop(key, None)

    rewrite(path, data=strip)
    with pytest.raises(UserError, match="got one of another algorithm"):
        load_sb3(path, VECTOR, DISCRETE)


@pytest.mark.parametrize(
    ("observation_space", "action_space", "message"),
    [
        (spaces.Box(-1.0, 1.0, (3,), np.float32), DISCRETE, r"got one for \(4,\) of float32"),
        (BOTH, DISCRETE, r"got one for \(4,\) of float32"),
        (spaces.Discrete(4), DISCRETE, r"got one for \(4,\) of float32"),
        (VECTOR, spaces.Discrete(4), "actions Discrete.4.*Discrete'> with {'n': '3'"),
        (VECTOR, spaces.Discrete(3, start=1), "'start': '0'"),
        (VECTOR, TORQUES, "actions Box.*Discrete'> with {'n': '3'"),
    ],
)
def test_agents_of_other_spaces_are_refused(observation_space, action_space, message, path):
    with pytest.raises(UserError, match=rf"Expected an agent for .*{message}"):
        load_sb3(path, observation_space, action_space)


def test_an_agent_whose_actions_have_other_bounds_is_refused(tmp_path):
    path = tmp_path / "model.zip"
    new_model(SAC, env=Fake(action_space=TORQUES)).save(path)
    with pytest.raises(UserError, match=r"Expected an agent for actions .*'low': '\[-2"):
        load_sb3(path, VECTOR, spaces.Box(np.float32([-10.0, -10.1]), np.float32([20.0, 30.3])))


def test_weights_of_other_shapes_than_the_files_words_are_refused(path):
    rewrite(path, data=lambda data: data.update(policy_kwargs={"net_arch": [32]}))
    with pytest.raises(UserError, match=r"whose action_net.weight has the shape \(3, 32\), got"):
        load_sb3(path, VECTOR, DISCRETE)


def test_huge_layers_that_the_weights_lack_are_never_allocated(path):
    rewrite(path, data=lambda data: data.update(policy_kwargs={"net_arch": [10**4, 10**4]}))
    with pytest.raises(UserError, match=r"its .* weights cannot fill such layers"):
        load_sb3(path, VECTOR, DISCRETE)


RELU = {"features_extractor_class": str(nn.ReLU)}


@pytest.mark.parametrize("arguments", [{"nonsense": 1}, {"net_arch": {"pi": -1}}, [1], RELU])
def test_arguments_that_no_policy_takes_are_refused(arguments, path):
    rewrite(path, data=lambda data: data.update(policy_kwargs=arguments))
    with pytest.raises(UserError, match="Expected policy_kwargs"):
        load_sb3(path, VECTOR, DISCRETE)


def test_no_pickle_of_a_crafted_file_is_run(path, tmp_path):
    marker = tmp_path / "executed"
    pickled = base64.b64encode(pickle.dumps(Payload(marker))).decode()
    hostile = {":type:": "<class 'dict'>", ":serialized:": pickled}

    def everywhere(data):
        for key, value in data.items():
            if isinstance(value, dict) and ":serialized:" in value and key != "policy_class":
                value[":serialized:"] = pickled
        data["policy_kwargs"] = hostile
        data["extra"] = hostile

    buffer = io.BytesIO()
    torch.save({"log_std": Payload(marker)}, buffer)
    rewrite(path, data=everywhere, pytorch_variables_pth=buffer.getvalue())
    assert type(load_sb3(path, VECTOR, DISCRETE)) is PPO
    rewrite(path, data=lambda data: data.update(policy_class=hostile))
    with pytest.raises(UserError, match="a policy of SB3's"):
        load_sb3(path, VECTOR, DISCRETE)
    assert not marker.exists()
    pickle.loads(base64.b64decode(pickled)).close()
    assert marker.exists()  # the payload does work


@pytest.mark.parametrize("old", [False, True])
def test_no_pickle_of_crafted_weights_is_run(old, path, tmp_path):
    marker = tmp_path / "executed"
    buffer = io.BytesIO()
    torch.save({"w": Payload(marker)}, buffer, _use_new_zipfile_serialization=not old)
    rewrite(path, policy_pth=buffer.getvalue())
    with pytest.raises(FileError, match=r"Expected tensors alone as policy.pth"):
        load_sb3(path, VECTOR, DISCRETE)
    assert not marker.exists()


@pytest.mark.parametrize("weights", [[torch.zeros(2)], {"a": 3}, {1: torch.zeros(2)}])
def test_weights_that_are_no_named_tensors_are_refused(weights, path):
    buffer = io.BytesIO()
    torch.save(weights, buffer)
    rewrite(path, policy_pth=buffer.getvalue())
    with pytest.raises(FileError, match="Expected tensors alone"):
        load_sb3(path, VECTOR, DISCRETE)


@pytest.mark.parametrize("data", [b"[]", b"{}", b"{", b"\xff", b"[" * 100_000])
def test_data_that_are_no_models_are_refused(data, path):
    rewrite(path, data=data)
    with pytest.raises(FileError, match="Expected a JSON object with a policy_class"):
        load_sb3(path, VECTOR, DISCRETE)


def test_files_that_are_no_models_are_refused(path, tmp_path):
    def refuse(expected, file=path):
        with pytest.raises(FileError, match=expected):
            load_sb3(file, VECTOR, DISCRETE)

    refuse("there is no such file", tmp_path / "none.zip")
    refuse("it is a folder", tmp_path)
    whole = path.read_bytes()
    for size in (0, 100, len(whole) // 2, len(whole) - 10):
        path.write_bytes(whole[:size])
        refuse("Expected a zip file that SB3 wrote in .*, got ")
    path.write_bytes(b"text")
    refuse("Expected a zip file that SB3 wrote .* damaged")
    path.write_bytes(whole)
    rewrite(path, policy_pth=None)
    refuse("with policy.pth in it, got data")
    rewrite(path, data=None)
    refuse("with data in it, got pytorch_variables.pth")
    zipfile.ZipFile(path, "w").close()
    refuse("with data in it, got an empty one")


def test_parts_that_grow_large_are_refused_unread(path, monkeypatch):
    monkeypatch.setattr(sb3_zip, "MAX_MODEL_BYTES", 2**20)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("ignored", bytes(2**22))
    assert load_sb3(path, VECTOR, DISCRETE)  # what nobody reads may be large
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    for name in ("data", "policy.pth"):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for key, part in parts.items():
                archive.writestr(key, bytes(2**21) if key == name else part)
        with pytest.raises(FileError, match=f"Expected {name} in .* at most 1 MiB, got 2 MiB"):
            load_sb3(path, VECTOR, DISCRETE)


def test_weights_that_grow_large_inside_are_refused_unread(path, monkeypatch):
    monkeypatch.setattr(sb3_zip, "MAX_MODEL_BYTES", 2**20)
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", bytes(2**21))
    rewrite(path, policy_pth=inner.getvalue())
    with pytest.raises(FileError, match=r"Expected tensors alone .* at most 1 MiB"):
        load_sb3(path, VECTOR, DISCRETE)


def test_large_files_are_refused_unread(path, monkeypatch):
    monkeypatch.setattr(sb3_zip, "MAX_MODEL_BYTES", 2**10)
    with pytest.raises(FileError, match="to be at most"):
        load_sb3(path, VECTOR, DISCRETE)


def test_the_keys_tell_the_algorithms_apart(tmp_path):
    for name in ("PPO", "A2C", "DQN", "SAC", "TD3"):
        kind = getattr(stable_baselines3, name)
        actions = DISCRETE if name in ("PPO", "A2C", "DQN") else TORQUES
        new_model(kind, env=Fake(action_space=actions)).save(tmp_path / name)
        assert type(load_sb3(tmp_path / f"{name}.zip", VECTOR, actions)) is kind
