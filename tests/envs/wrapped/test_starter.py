"""A first TOML file: it can be attacked as it is, and says what was guessed."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from typer.testing import CliRunner

from sada_gym import attack
from sada_gym.cli import app
from sada_gym.envs.wrapped import starter
from sada_gym.envs.wrapped.scores import Episode
from sada_gym.envs.wrapped.starter import starter_file
from sada_gym.errors import UserError
from sada_gym.foundations.files import parse_toml, read_toml


class Slide(gym.Env):
    """A block on a slope: what is a parameter, what is state, what is refused, what is dead."""

    slope = 1.0
    observation_space = gym.spaces.Box(-np.inf, np.inf, (1,))
    action_space = gym.spaces.Discrete(2)

    def __init__(self, gravity: float = -10.0, friction: float = 0.5, render_mode=None, luck=True):
        if not -12.0 < gravity < 0.0:
            raise ValueError("another planet")
        self.gravity, self.friction, self.pull, self.spare = gravity, friction, 4, 3.0
        self.speed = 0.25

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.speed = 1.0
        return np.array([1.0], np.float32), {}

    def step(self, action):
        force = -0.1 * self.gravity * self.friction * self.slope + self.pull * action
        self.speed = 0.9 * self.speed + force
        return np.array([self.speed], np.float32), float(self.speed), False, False, {}


class Loaded(Slide):
    """Its constructor computes a load and a table from a mass and a force."""

    def __init__(self):
        super().__init__()
        self.mass, self.force = 2.0, 3.0
        self.load = self.mass * 10.0
        self.forces = np.array([self.force, 0.0])

    def step(self, action):
        seen, reward, *ends = super().step(action)
        return seen + self.load + self.forces[0], reward, *ends


@pytest.fixture(scope="module", autouse=True)
def slide():
    gym.register("Slide-v0", entry_point=Slide, max_episode_steps=8)
    yield
    del gym.registry["Slide-v0"]


@pytest.fixture(scope="module")
def agent(tmp_path_factory):
    path = tmp_path_factory.mktemp("agents") / "ppo.zip"
    PPO("MlpPolicy", gym.make("Slide-v0"), n_steps=64, seed=0, device="cpu").learn(64).save(path)
    return path


def invoke(*args):
    return CliRunner().invoke(app, ["init", *map(str, args)], env={"COLUMNS": "200"})


@pytest.mark.long
def test_a_file_names_what_can_change_and_is_attacked_as_it_is(agent, tmp_path):
    file = tmp_path / "slide.toml"
    result = invoke("Slide-v0", "--agent", agent, "--out", file)
    assert result.exit_code == 0, result.output
    table = read_toml(file)
    parameters = table["parameters"]
    assert parameters["gravity"] == [-11.0, -9.09]  # half to twice is refused
    assert parameters["friction"] == [0.25, 1.0]
    assert parameters["slope"] == [0.5, 2.0]  # of the class
    assert parameters["pull"] == {"kind": "attribute", "low": 2, "high": 8, "integer": True}
    assert {"speed", "spare"}.isdisjoint(parameters)
    assert "# spare = [1.5, 6.0]  # now 3  # changed nothing when it was tried" in file.read_text()
    assert f"Then: sada-gym attack {file}" in result.stdout
    done = attack(str(file), "random", out=tmp_path / "run", budget=0, samples=8, pictures=False)
    assert len(done.samples) == 8


def test_what_follows_from_a_parameter_is_derived_and_not_proposed(agent):
    gym.register("Loaded-v0", entry_point=Loaded, max_episode_steps=8)
    try:
        text = starter_file("Loaded-v0", agent).text
    finally:
        del gym.registry["Loaded-v0"]
    assert "mass = [1.0, 4.0]  # now 2\n" in text
    assert text.count("[derived]") == 1
    assert 'load = "mass * 10.0"\n' in text
    assert "\nload = [" not in text
    assert "# load follows from others\n" in text
    assert "# force is left out: forces would keep the value computed from it\n" in text


@pytest.mark.long
def test_an_environment_without_a_limit_of_steps_gets_one(agent, tmp_path, monkeypatch):
    monkeypatch.setattr(starter, "LIMIT", 12)
    gym.register("Endless-v0", entry_point=Slide)
    try:
        file = tmp_path / "endless.toml"
        result = invoke("Endless-v0", "--agent", agent, "--out", file)
        assert result.exit_code == 0, result.output
        assert "has no TimeLimit, so the file ends an episode after 12 steps" in result.output
        assert read_toml(file)["max_steps"] == 12
    finally:
        del gym.registry["Endless-v0"]


def test_the_threshold_lies_between_the_agent_and_random_actions(tmp_path, agent, monkeypatch):
    # the best agent of all pulls each time
    monkeypatch.setattr(PPO, "predict", lambda self, seen, **_: (np.ones(len(seen), int), None))
    starter = starter_file("Slide-v0", agent)
    score, threshold = read(starter.text, tmp_path)
    limit = score[1] + threshold * (score[2] - score[1])
    best = sum(total_speeds(1))
    assert sum(total_speeds(0)) < limit < best < score[2]
    assert score[1] == 0.0  # no reward is below zero
    assert "halfway between" in " ".join(starter.notes)


def test_an_agent_that_is_no_better_than_chance_gets_no_threshold(tmp_path, agent, monkeypatch):
    monkeypatch.setattr(PPO, "predict", lambda self, seen, **_: (np.zeros(len(seen), int), None))
    file = tmp_path / "slide.toml"
    result = invoke("Slide-v0", "--agent", agent, "--out", file)
    assert result.exit_code == 0, result.output
    assert "does no better than random actions" in result.stdout
    assert "sada-gym attack" not in result.stdout.rpartition("Written to")[2]
    assert "fooling_threshold" not in read_toml(file)


def test_a_controller_inside_is_not_compared_with_random_actions():
    made = starter_file("CartPole-v1", "built-in", max_steps=12)
    assert made.ready
    assert "random actions" not in " ".join(made.notes)
    lines = made.text.splitlines()
    assert 'agent = "built-in"' in lines
    assert not any(line.startswith("agent_id") for line in lines)
    assert 'score = ["return", 0.0, 10.0]' in lines
    assert any(line.startswith("fooling_threshold = 0.4") for line in lines)


def test_rewards_that_are_all_zero_give_a_range_and_no_threshold():
    zeros = Episode(np.zeros(3), (), (), ({},), terminated=False, truncated=True)
    (_, low, high), threshold, notes = starter._score([zeros], [zeros])
    assert low == 0.0 < high
    assert threshold is None
    assert "no better than random actions" in notes[-1]


def test_keywords_of_any_kind_are_toml():
    given = {"a b": {"c": [1, "d"], "e": True}, "f": 0.5}
    text = "\n".join(starter._line(*item) for item in given.items())
    assert parse_toml(text.encode(), "any") == given


class Hall(gym.Env):
    """Nested settings, and wind and load that are zero by default; success is luck."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (1,))
    action_space = gym.spaces.Discrete(2)

    def __init__(self, wind_gust: float = 0, payload: float = 0.0, count: int = 0):
        self.wind_gust, self.payload = wind_gust, payload
        self.config = {
            "floor": {"friction": 0.5, "name": "wood"},
            "light.power": 2.0,
            3: 4.0,
            "speeds": [2.0],
        }

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        push = self.wind_gust + self.payload + self.config["floor"]["friction"]
        push += self.config["light.power"] + self.config["speeds"][0] + action
        return np.array([push], np.float32), push, False, False, {"is_success": False}


HALL = "def rest(observation):\n    return 0\n"


def test_zeros_nested_settings_and_an_agent_of_a_module_beside_the_file(tmp_path):
    gym.register("Hall-v0", entry_point=Hall, max_episode_steps=4)
    try:
        (tmp_path / "hall_agents.py").write_text(HALL)
        file = tmp_path / "hall.toml"
        result = invoke("Hall-v0", "--agent", "hall_agents:rest", "--out", file)
        assert result.exit_code == 0, result.output
        table = read_toml(file)
        assert table["agent"] == "hall_agents:rest"
        parameters = table["parameters"]
        assert parameters["wind_gust"] == parameters["payload"] == [0.0, 1.0]
        nested = {"kind": "config", "low": 0.25, "high": 1.0, "name": "floor.friction"}
        assert parameters["floor_friction"] == nested
        assert parameters["speeds_0_"] == nested | {"low": 1.0, "high": 4.0, "name": "speeds[0]"}
        assert parameters["light_power"]["name"] == "light.power"
        assert "count" not in parameters
        assert "fooling_threshold" not in table  # neither ever succeeds
        file.write_text(
            file.read_text().replace("# fooling_threshold =", "fooling_threshold = 0.5")
        )
        done = attack(str(file), "random", out=tmp_path / "run", budget=0, samples=4)
        assert len(done.samples) == 4
    finally:
        del gym.registry["Hall-v0"]


def total_speeds(action, speed=1.0):
    for _ in range(8):
        speed = 0.9 * speed + 0.5 + 4 * action
        yield speed


def read(text, folder):
    (folder / "starter.toml").write_text(text)
    table = read_toml(folder / "starter.toml")
    return table["score"], table["fooling_threshold"]


def test_the_agents_path_is_relative_to_the_file(agent, tmp_path):
    folder = agent.parent / "files"
    starter = starter_file("Slide-v0", agent, folder=folder)
    assert 'agent = "../ppo.zip"' in starter.text


@pytest.mark.long
def test_without_an_agent_a_stand_in_is_trained(tmp_path):
    file = tmp_path / "new.toml"
    result = invoke("Slide-v0", "--steps", 1, "--out", file)
    assert result.exit_code == 0, result.output
    assert "a stand-in learns for 1 steps" in result.stderr
    assert read_toml(file)["agent"] == "new.zip"
    assert (tmp_path / "new.zip").is_file()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["Slide-v0", "--agent", "none.zip"], "Expected the file of an agent, got none.zip"),
        (["Slid-v0"], "Did you mean 'Slide-v0'"),
        (["SADA-UAV-v0"], "ready to attack: sada-gym attack SADA-UAV-v0"),
        (["Slide-v0", "--out", "a.txt"], "one of .toml"),
        (["Slide-v0", "--out", __file__.replace(".py", ".toml"), "stray"], "got 'stray'"),
        (["Blackjack-v1", "--steps", "1"], "Expected PPO of Stable-Baselines3 to learn in Blackj"),
    ],
)
def test_bad_input_is_a_sentence(args, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = invoke(*args)
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_there_stays(agent, tmp_path):
    file = tmp_path / "slide.toml"
    file.write_text("mine")
    result = invoke("Slide-v0", "--agent", agent, "--out", file)
    assert result.exit_code == 2
    assert file.read_text() == "mine"


def test_an_attack_on_a_plain_environment_names_init(tmp_path):
    with pytest.raises(UserError, match="sada-gym init Slide-v0"):
        attack("Slide-v0", "random", out=tmp_path / "run")
