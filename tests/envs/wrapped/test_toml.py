"""Applications in TOML files: the same as in Python, and one sentence for each mistake."""

import codecs
import inspect
import json
import re
import shutil
import sys
from contextlib import closing
from dataclasses import dataclass, fields
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from typer.testing import CliRunner

from sada_gym import GymnasiumApplication, attack, load_run, make_application
from sada_gym.cli import app
from sada_gym.envs.wrapped import bindings, toml
from sada_gym.envs.wrapped.disturbances import (
    ActionDelay,
    ActionGain,
    ActionNoise,
    ObservationDelay,
    ObservationDropout,
    ObservationNoise,
    RepeatedActions,
)
from sada_gym.envs.wrapped.toml import read_application
from sada_gym.errors import FileError, UserError
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Oracle
from sada_gym.foundations.files import MAX_TOML_BYTES, read_toml
from sada_gym.testing import rules

POLE = """
environment = "CartPole-v1"
agent = "agents/pole.zip"
score = ["return", 0, 60.0]
fooling_threshold = 0.5
max_steps = 60

[parameters]
gravity = [5, 20.0]
length = { kind = "attribute", low = 0.2, high = 2.0, unit = "m", paths = ["length"] }
late = { kind = "observation-delay", low = 0, high = 3 }
"""
BINDING_KEYS = {key for kind in toml.KINDS.values() for key in toml.binding_keys(kind)}
RANDOM = {"adversary": "random", "budget": 12, "samples": 12, "pictures": False}


@pytest.fixture(scope="module")
def model():
    return PPO("MlpPolicy", gym.make("CartPole-v1"), n_steps=64, seed=0, device="cpu")


@pytest.fixture
def pole(tmp_path, model):
    """A TOML file, and a folder with the agent that it names."""
    model.save(tmp_path / "agents" / "pole.zip")
    (tmp_path / "pole.toml").write_text(POLE)
    return tmp_path / "pole.toml"


def test_parameters_may_be_logarithmic_factors_in_slices(pole):
    tables = """
masspole = { kind = "attribute", low = 0.1, high = 10, log = true, nominal = 0.5 }
state = { kind = "attribute", low = 0.5, high = 2, factor = true, paths = "state[2:]" }
"""
    pole.write_text(POLE.replace("gravity = [5, 20.0]", tables))
    application = read_application(pole)
    mass = application.parameters.parameters[0]
    assert (mass.low, mass.high, mass.log) == (0.1, 10.0, True)
    assert application.settings["parameters"]["state"]["factor"] is True
    nominal = application.parameters.physical(application.nominal)
    assert nominal == pytest.approx([0.5, 1.0, 0.5, 0.0], abs=1e-6)


@pytest.mark.long
def test_a_density_in_a_file_tells_how_often_the_agent_fails_in_use(pole, tmp_path):
    use = "{ 'truncated-normal' = [9.8, 2.0, 5.0, 20.0] }"
    table = f'gravity = {{ kind = "attribute", low = 5, high = 20, nominal = {use} }}'
    pole.write_text(POLE.replace("gravity = [5, 20.0]", table))
    options = ["--budget", "20", "--samples", "30", "--out", str(tmp_path / "run")]
    result = CliRunner().invoke(app, ["attack", str(pole), "--adversary", "random", *options])
    assert result.exit_code == 0, result.output
    assert "fails with probability" in " ".join(result.output.split())
    in_use = json.loads((tmp_path / "run" / "result.json").read_text())["in_use"]
    low, high = in_use["interval_95"]
    assert 0.0 <= low <= in_use["probability"] <= high <= 1.0
    assert in_use["density"] == {"gravity": {"truncated-normal": [9.8, 2.0, 5.0, 20.0]}}
    assert (in_use["worlds"], in_use["held"]) == (30, pytest.approx(1.0))
    pole.write_text(POLE.replace("gravity = [5, 20.0]", table.replace("2.0,", "0.0,")))
    with pytest.raises(UserError, match="sd above 0"):
        read_application(pole)


def test_a_file_means_what_the_constructor_means(pole, model):
    read = read_application(pole)
    made = GymnasiumApplication(
        "CartPole-v1",
        agent=model,
        parameters={
            "gravity": (5.0, 20.0),
            "length": bindings.Attribute(0.2, 2.0, unit="m", paths="length"),
            "late": ObservationDelay(0, 3),
        },
        score=("return", 0.0, 60.0),
        fooling_threshold=0.5,
        max_steps=60,
        name="CartPole",
    )
    mu = np.random.default_rng(0).uniform(-1, 1, (8, 3))
    expected = made.evaluate(mu, range(8)).score
    np.testing.assert_array_equal(read.evaluate(mu, range(8)).score, expected)
    assert len(set(expected)) > 1
    assert read.fingerprint == made.fingerprint is not None
    assert read.agent_name == "pole"
    assert read.parameters.parameters == made.parameters.parameters


def test_a_byte_order_mark_and_capitals_in_the_suffix_do_no_harm(pole):
    marked = pole.with_name("MARKED.TOML")
    marked.write_bytes(codecs.BOM_UTF8 + pole.read_bytes())
    with closing(Evaluator(str(marked))) as evaluator:
        assert evaluator.application.fingerprint == read_application(pole).fingerprint


def test_a_run_remembers_the_file_that_described_its_application(pole, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    attack("pole.toml", out="run", **RANDOM)
    monkeypatch.chdir(tmp_path.parent)
    run = load_run(tmp_path / "run")
    assert (run.given.by, run.given.path) == ("toml", pole)
    other = pole.read_text().replace("0.5", "0.25")
    assert other != pole.read_text()
    for change in (lambda: None, lambda: pole.write_text(other), pole.unlink):
        change()
        with run.open() as opened:
            again = opened.application.evaluate(run.samples.mu[:2], run.samples.seed[:2].tolist())
        np.testing.assert_array_equal(again.score, run.samples.score[:2])


def test_every_key_of_the_constructor_can_stand_in_a_file():
    arguments = inspect.signature(GymnasiumApplication).parameters
    keys, required = toml.application_keys()
    assert [*keys] == [*arguments]
    assert all(keys.values())
    assert required == [
        key for key, argument in arguments.items() if argument.default is argument.empty
    ]


def test_the_page_names_every_key_and_kind_and_its_files_are_right(tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "toml.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```toml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    file = tmp_path / "lander.toml"
    file.write_text(block, encoding="utf-8")
    table = read_toml(file)
    keys, required = toml.application_keys()
    assert {*required} <= {*table} <= {*keys}
    for name, value in table["parameters"].items():
        assert toml.binding_of(name, value, Path("lander.toml"))
    for name in (*keys, *toml.KINDS, *BINDING_KEYS):
        assert f"`{name}`" in page


def test_every_field_of_every_kind_has_a_type():
    for kind in toml.KINDS.values():
        keys = toml.binding_keys(kind)
        assert [*keys] == [field.name for field in fields(kind)]
        assert all(keys.values())


def test_a_new_field_is_a_key_with_its_type(monkeypatch):
    @dataclass(frozen=True)
    class Gravity(bindings.Keyword):
        planet: str | None = None
        moons: tuple[int, ...] = ()

    monkeypatch.setitem(toml.KINDS, "gravity", Gravity)
    table = {"kind": "gravity", "low": 1, "high": 2, "planet": "Mars", "moons": [1, 2]}
    binding = toml.binding_of("x", table, Path("a.toml"))
    assert binding == Gravity(1, 2, planet="Mars", moons=(1, 2))
    with pytest.raises(UserError, match=r"'planet' of parameter 'x' in a\.toml to be a text"):
        toml.binding_of("x", {**table, "planet": 3}, Path("a.toml"))


@pytest.mark.parametrize(
    ("table", "binding"),
    [
        ({"kind": "keyword", "low": 1, "high": 2, "name": "g"}, bindings.Keyword(1, 2, name="g")),
        (
            {"kind": "attribute", "low": 1, "high": 2, "paths": ["a.b", "c[1]"]},
            bindings.Attribute(1, 2, paths=("a.b", "c[1]")),
        ),
        ({"kind": "reset-option", "choices": ["dry", 1]}, bindings.ResetOption(choices=("dry", 1))),
        (
            {"kind": "config", "low": 1, "high": 4, "integer": True, "name": "lanes_count"},
            bindings.Config(1, 4, integer=True, name="lanes_count"),
        ),
        (
            {"kind": "observation-noise", "low": 0.0, "high": 0.1, "entries": [2, 3]},
            ObservationNoise(0.0, 0.1, entries=(2, 3)),
        ),
        ({"kind": "observation-delay", "low": 0, "high": 3}, ObservationDelay(0, 3)),
        ({"kind": "observation-dropout", "low": 0, "high": 0.5}, ObservationDropout(0, 0.5)),
        ({"kind": "action-noise", "low": 0, "high": 0.5}, ActionNoise(0, 0.5)),
        (
            {"kind": "action-delay", "low": 0, "high": 2, "unit": "steps"},
            ActionDelay(0, 2, unit="steps"),
        ),
        ({"kind": "action-gain", "low": 0.5, "high": 1.5}, ActionGain(0.5, 1.5)),
        ({"kind": "repeated-actions", "low": 1, "high": 4}, RepeatedActions(1, 4)),
    ],
)
def test_every_kind_is_its_binding(table, binding):
    assert toml.binding_of("x", table, Path("a.toml")) == binding


def test_paths_are_relative_to_the_file(pole, tmp_path, monkeypatch):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert read_application("../pole.toml").agent_name == "pole"


def test_an_agent_can_be_an_object_of_a_module(pole, tmp_path, monkeypatch):
    (tmp_path / "leaning.py").write_text("def lean(seen):\n    return int(seen[2] > 0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    pole.write_text(POLE.replace("agents/pole.zip", "leaning:lean") + "\n")
    assert read_application(pole).fingerprint is None
    pole.write_text('agent_id = "lean-1"' + POLE.replace("agents/pole.zip", "leaning:lean"))
    application = read_application(pole)
    assert application.agent_name == "lean-1"
    assert application.fingerprint is not None
    assert application.evaluate([[0.0, 0.0, -1.0]], [0]).score > 0.3


def test_modules_of_one_name_beside_two_files_are_told_apart(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "nodding", raising=False)
    for folder, action in (("one", 0), ("other", 1)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "nodding.py").write_text(f"def act(seen):\n    return {action}\n")
        text = 'agent_id = "nod"' + POLE.replace("agents/pole.zip", "nodding:act")
        (tmp_path / folder / "pole.toml").write_text(text)
    copy = shutil.copytree(tmp_path / "one", tmp_path / "copy")
    for folder in (tmp_path / "one", tmp_path / "one", copy):  # the same file is the same module
        read_application(folder / "pole.toml")
    with pytest.raises(
        UserError, match=r"'nodding' of .*other.pole.toml to be .*other.*, got .*one"
    ):
        read_application(tmp_path / "other" / "pole.toml")
    place = tmp_path / "other" / "pole.toml"
    place.write_text(POLE.replace("CartPole-v1", "nodding:CartPole-v1"))
    with pytest.raises(UserError, match="which has the same name"):
        read_application(place, agent=lambda seen: 0)
    (tmp_path / "other" / "json.py").write_text("")
    place.write_text(POLE.replace("agents/pole.zip", "json:loads"))
    with pytest.raises(UserError, match=r"'json' of .* which has the same name"):
        read_application(place)


def test_statistics_are_relative_to_the_file_and_need_trust(pole, tmp_path):
    statistics = VecNormalize(DummyVecEnv([lambda: gym.make("CartPole-v1")]))
    statistics.obs_rms.mean += 1.0
    statistics.save(str(tmp_path / "agents" / "statistics.pkl"))
    with_statistics = 'vec_normalize = "agents/statistics.pkl"' + POLE
    pole.write_text(with_statistics)
    with pytest.raises(UserError, match="Expected allow_pickle=True with vec_normalize"):
        read_application(pole)
    pole.write_text("allow_pickle = true\n" + with_statistics)
    trusted = read_application(pole)
    pole.write_text(POLE)
    with pytest.raises(UserError, match=r"VecNormalize in .*statistics.pkl: without its statist"):
        read_application(pole)
    pole.write_text("vec_normalize = false\n" + POLE)
    assert trusted.fingerprint != read_application(pole).fingerprint


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "score =",
            "scor =",
            r"the key in .*pole.toml to be one of .*got 'scor'. Did you mean score",
        ),
        ("agent =", "max_step =", "got 'max_step'. Did you mean max_steps"),
        ('agent = "agents/pole.zip"', "", r"Expected the key 'agent' in .*pole.toml, got none"),
        ("score =", "score ", r"TOML file in .*pole.toml, got something else: .*line 4"),
        ("max_steps = 60", "max_steps = 60\nmax_steps = 6", "TOML file in .*line 7"),
        ("max_steps = 60", 'max_steps = "60"', r"'max_steps' in .*pole.toml to be a whole number"),
        ("max_steps = 60", "max_steps = true", "'max_steps' in .* to be a whole number, got True"),
        ("threshold = 0.5", "threshold = [0.5]", "'fooling_threshold' in .* to be a number"),
        ('"CartPole-v1"', "1", r"'environment' in .* to be a text in quotes, .* got 1\."),
        ('["return", 0, 60.0]', "3", "'score' in .* to be .*success.*, got 3"),
        ("max_steps = 60", "allow_pickle = 1", "'allow_pickle' in .* to be true or false, got 1"),
        ("[parameters]\n", "parameters = 3\n[env_kwargs]\n", "'parameters' in .* to be a table"),
        ("[5, 20.0]", "[5]", r"parameter 'gravity' in .*pole.toml to be \[low, high\], got \[5\]"),
        ("[5, 20.0]", '["a", 2]', r"parameter 'gravity' in .* to be \[low, high\]"),
        ("[5, 20.0]", "5", "parameter 'gravity' in .* to be .* or a table with a kind, got 5"),
        (
            "[5, 20.0]",
            "{ low = 1, high = 2 }",
            "the kind of parameter 'gravity' in .* none. .*keyword",
        ),
        ('"attribute"', '"atribute"', "got 'atribute'. Did you mean attribute"),
        ("unit =", "units =", "the key of parameter 'length' in .* got 'units'. Did you mean unit"),
        ("unit =", "key =", "the key of parameter 'length' in .* got 'key'"),
        ("low = 0.2", 'low = "a"', "'low' of parameter 'length' in .* to be a number, got 'a'"),
        ("[5, 20.0]", "[20.0, 5]", "Expected finite low < high for parameter 'gravity'"),
        ("[5, 20.0]", "[nan, 5]", "Expected finite low < high for parameter 'gravity'"),
        ("gravity", "gravty", "Expected parameter 'gravty' .* Did you mean gravity"),
        ("CartPole-v1", "CartPole-v7", "Expected a registered environment id, got 'CartPole-v7'"),
        ("agents/pole.zip", "pole.zip", "Expected an SB3 zip .*pole.zip: no such file"),
        (
            "agents/pole.zip",
            "no_such:thing",
            r"module:object, got 'no_such:thing' \(ModuleNotFound",
        ),
        ("agents/pole.zip", "json:thing", r"module:object, got 'json:thing' \(AttributeError"),
    ],
)
def test_bad_files_get_a_sentence(old, new, message, pole):
    assert old in POLE
    pole.write_text(POLE.replace(old, new, 1))
    with pytest.raises(UserError, match=message):
        read_application(pole)


def test_files_that_are_no_toml_get_a_sentence(pole, tmp_path):
    with pytest.raises(FileError, match="there is no such file"):
        read_application(tmp_path / "none.toml")
    pole.write_bytes(b"\xff\xfe")
    with pytest.raises(FileError, match=r"Expected a TOML file in .*utf-8"):
        read_application(pole)
    pole.write_text("a = " + "[" * 100_000)
    with pytest.raises(FileError, match="Expected a TOML file in"):
        read_application(pole)
    pole.write_text("#" * (MAX_TOML_BYTES + 1))
    with pytest.raises(FileError, match="at most 1 MiB"):
        read_application(pole)


def test_keywords_of_ids_do_not_go_with_files(pole):
    with pytest.raises(UserError, match=r"only with its id, got {'agent': 'x'} with .*pole.toml"):
        make_application(str(pole), agent="x")


def test_an_attack_takes_a_file_and_its_settings_name_no_folder(pole, tmp_path, monkeypatch):
    whole = attack(str(pole), out=tmp_path / "whole", **RANDOM)
    application = read_application(pole)
    assert whole.result.settings.experiment.target.track == "CartPole-v1"
    assert whole.result == attack(application, out=tmp_path / "python", **RANDOM).result
    assert str(tmp_path) not in (tmp_path / "whole" / "result.json").read_text()
    assert str(tmp_path) not in whole.settings.model_dump_json()
    # moved, it is the same run
    moved = tmp_path / "moved"
    moved.mkdir()
    for name in ("pole.toml", "agents"):
        (tmp_path / name).rename(moved / name)
    monkeypatch.chdir(moved)
    resumed = attack("pole.toml", out=tmp_path / "whole", resume=True, **RANDOM)
    assert resumed.result == whole.result


@pytest.mark.slow
def test_workers_build_the_application_from_the_file(pole, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    alone = attack("pole.toml", out=tmp_path / "alone", **RANDOM)
    together = attack("pole.toml", out=tmp_path / "together", workers=2, **RANDOM)
    assert together.result == alone.result


def test_another_agent_under_the_same_name_is_another_run(pole, tmp_path):
    attack(str(pole), out=tmp_path / "run", **RANDOM)
    PPO("MlpPolicy", gym.make("CartPole-v1"), seed=1, device="cpu").save(tmp_path / "agents/pole")
    with pytest.raises(UserError, match="fingerprint was"):
        attack(str(pole), out=tmp_path / "run", resume=True, **RANDOM)


def test_an_oracle_takes_a_file(pole):
    mu = np.zeros((2, 3))
    with Oracle(str(pole), budget=4) as oracle:
        assert oracle(mu).shape == (2,)
    assert json.loads(json.dumps(read_application(pole).settings))["environment"] == "CartPole-v1"


def test_dead_parameters_are_found_by_name(pole):
    pole.write_text(POLE + "screen_width = [100, 200]\n")
    with pytest.raises(AssertionError, match="screen_width"):
        rules.check_live_parameters(read_application(pole))


def test_the_command_line_shows_parameters_with_units_and_whole_numbers(pole):
    pole.write_text(pole.read_text().replace("high = 3 }", 'high = 2, unit = "steps" }'))
    shown = CliRunner().invoke(app, ["envs", str(pole)]).output
    assert re.search(r"length +0\.2 +2 +m", shown), shown
    assert re.search(r"late +- +- +0, 1, 2 steps", shown), shown
