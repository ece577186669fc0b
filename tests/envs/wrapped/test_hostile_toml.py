"""Whatever stands in a TOML file: an application whose scores are numbers, or one sentence."""

import json
import random
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from sada_gym.cli import app
from sada_gym.envs.wrapped.application import GymnasiumApplication
from sada_gym.envs.wrapped.bindings import Attribute
from sada_gym.envs.wrapped.toml import KINDS, application_keys, binding_keys, read_application
from sada_gym.errors import UserError
from sada_gym.parameters import Parameter

PLAIN = {
    "environment": '"CartPole-v1"',
    "agent": '"constant:act"',
    "agent_id": '"constant"',
    "parameters": "{gravity = [5.0, 15.0]}",
    "score": '["length", 500]',
    "fooling_threshold": "0.5",
}
NUMBERS = ["0", "-0.0", "1", "-1", "2", "0.5", "1e308", "-1e400", "inf", "-inf", "nan"]
NUMBERS += [str(n) for n in (2**53 + 1, 2**63 - 1, -(2**63), 2**64, 10**26, 10**400)]
TEXTS = ['""', '"a"', '"length"', '"gravity"', '"a[0]"', '"a["', '"."', '"a..b"', '"[0]"', '"a:b"']
TEXTS += ['":"', '"a:"', '"/"', '"~"', '".."', '"success"', '"mean"', '"NoSuch-v9"', '"é☃"']
TEXTS += [r'"\u0000"', r'"\n"', r'"\u001b[31m"', f'"{"x" * 300}"', f'"{"x" * 5_000}"']
ARRAYS = ["[]", "[[]]", "[1, 2]", "[2, 1]", "[1, 1]", "[inf, nan]", "[nan, nan]", "[0, inf]"]
ARRAYS += ["[-1e308, 1e308]", "[0, 1e-320]", f"[0, {2**63}]", f"[{2**64}, 1]", "[1, 2, 3]"]
ARRAYS += ["[true, false]", "[1979-05-27, 1980-01-01]", "[[1, 2], [3, 4]]", "[{}, {}]", '[1, "a"]']
ARRAYS += ['["return", 0, 1]', '["return", 1, 0]', '["return", nan, nan]', '["length", inf]']
ARRAYS += ['["length", true]', '["success"]', '["a", "a"]', f'["{"y" * 300}", 1]']
OTHERS = ["true", "false", "{}", "{a = {b = {}}}"]
OTHERS += ["1979-05-27", "07:32:00", "1979-05-27T07:32:00Z"]
KINDS_OF_VALUES = {str: TEXTS, list: ARRAYS, dict: OTHERS[2:4], bool: OTHERS[:2]}
NAMES = ["gravity", "length", "masspole", "force_mag", '""', '"a b"', r'"\n"', '"a.b"']
NAMES += [f'"{"n" * 90}"', f'"{"n" * 300}"']


def value(rng, types):
    """Return mostly a value of the key's types, which gets further than others."""
    right = [value for kind in types for value in KINDS_OF_VALUES.get(kind, NUMBERS)]
    return rng.choice(right or TEXTS if rng.random() < 0.8 else NUMBERS + TEXTS + ARRAYS + OTHERS)


def parameter(rng):
    if rng.random() < 0.15:
        return rng.choice(ARRAYS + OTHERS)
    name = rng.choice([*KINDS])
    keys = binding_keys(KINDS[name])
    table = {"low": rng.choice([*["0"] * 5, *NUMBERS]), "high": rng.choice(NUMBERS)}
    if rng.random() < 0.3:
        table = {"choices": rng.choice(ARRAYS)}
    for key in rng.sample(sorted(keys.keys() - {"low", "high", "choices"}), rng.randint(0, 2)):
        table[key] = value(rng, keys[key])
    return f'{{kind = "{name}", {", ".join(f"{key} = {text}" for key, text in table.items())}}}'


def random_file(seed):
    rng, table = random.Random(seed), dict(PLAIN)
    if rng.random() < 0.5:
        keys, _ = application_keys()
        for key in rng.sample(sorted(keys), 2):
            table[key] = value(rng, keys[key])
    else:
        names = rng.sample(NAMES, rng.randint(1, 2))
        parameters = ", ".join(f"{name} = {parameter(rng)}" for name in names)
        table["parameters"] = f"{{{parameters}}}"
    return written(table)


def written(table):
    return "\n".join(f"{key} = {text}" for key, text in table.items())


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "constant.py").write_text("def act(observation):\n    return 0\n")
    sys.modules.pop("constant", None)
    yield tmp_path / "random.toml"
    sys.modules.pop("constant", None)


def check_random_files(file, seeds):
    """Read files and play some worlds of those that are accepted; return how many these are."""
    accepted, sentences = 0, []
    for seed in seeds:
        file.write_text(random_file(seed))
        try:
            application = read_application(file)
            ends = np.linspace(-1, 1, 3)[:, None].repeat(len(application.parameters), axis=1)
            score = application.evaluate(ends, range(3)).score
        except UserError as error:
            sentences.append(str(error))
            continue
        except Exception as error:
            raise AssertionError(f"{seed}: {error!r} for\n{file.read_text()}") from error
        assert ((score >= 0) & (score <= 1)).all(), seed
        json.dumps(application.settings)
        accepted += 1
    assert [text for text in sentences if not text.startswith("Expected ")] == []
    return accepted


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_some_hundred_random_files(file):
    assert check_random_files(file, range(400)) > 10


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_some_thousand_random_files(file):
    assert check_random_files(file, range(1_000, 6_000)) > 100


WRONG = {
    "episodes": [
        (str(10**26), "whole numbers of 64 bits"),
        ("100_001", "episodes of at most 100,000"),
        ("0", "episodes of at least 1"),
    ],
    "timeout": [("inf", "number of seconds above 0"), ("nan", "number of seconds above 0")],
    "agent_timeout": [("1e7", "above 0 and of at most 1e6, got 10000000.0")],
    "sample_size": [(str(2**62), "sample_size of at most 9,007,199,254,740,992")],
    "env_kwargs": [
        ("{sutton_barto_reward = 1979-05-27}", "no dates or times in .*, got 1979-05-27"),
        ("{sutton_barto_reward = [[07:32:00]]}", "no dates or times in .*, got 07:32:00"),
        (f"{{sutton_barto_reward = {{a = {2**63}}}}}", "of 64 bits in .*, got one of 65 bits"),
    ],
    "vec_normalize": [("3", "the path of a file in quotes, or false")],
    "agent": [("3", "a text in quotes, or a command")],
    "parameters": [
        ("{gravity = [0, inf]}", "finite low < high for parameter 'gravity'"),
        ("{gravity = [-1.7e308, 1.7e308]}", "finite low < high for parameter 'gravity'"),
        ('{late = {kind = "action-delay", low = 0, high = inf}}', "finite low < high .* 'late'"),
        ('{late = {kind = "action-delay", low = nan, high = 2}}', "finite low < high .* 'late'"),
        ('{late = {kind = "action-delay", low = 0, high = 1e7}}', "at most 1e.06, whole numbers"),
        ('{late = {kind = "action-delay", choices = [0, 1.5]}}', "whole numbers, got"),
        ('{late = {kind = "action-delay", choices = [nan, 1]}}', "whole numbers, got"),
        (
            f'{{gravity = {{kind = "attribute", integer = true, low = 0, high = {2**53 + 1}}}}}',
            r"whole numbers of 'gravity' within -2\*\*51 and 2\*\*51",
        ),
        (f'{{gravity = {{kind = "attribute", choices = [1, {2**64}]}}}}', "of 64 bits"),
        (f"{{{'n' * 101} = [1, 2]}}", "name in one line of at most 100 characters"),
        (r'{"a\nb" = [1, 2]}', "name in one line"),
        (
            r'{gravity = {kind = "attribute", low = 1, high = 2, unit = "\u0000"}}',
            "a unit, choice or",
        ),
        ('{"" = [1, 2]}', "name to be a text, got ''"),
        ('{gravity = {kind = "attribute", low = 1, high = 2, paths = [1]}}', "path|attribute"),
        (
            '{gravity = {kind = "attribute", factor = true, choices = ["a", "b"]}}',
            "numbers as choices of 'gravity', which is a factor",
        ),
    ],
}


@pytest.mark.parametrize(
    ("key", "text", "message"),
    [(key, text, message) for key, cases in WRONG.items() for text, message in cases],
)
def test_a_value_that_no_application_can_have_gets_a_sentence(file, key, text, message):
    file.write_text(written({**PLAIN, key: text}))
    with pytest.raises(UserError, match=message):
        read_application(file)
    result = CliRunner().invoke(app, ["attack", str(file)], env={"COLUMNS": "200"})
    assert result.exit_code == 2
    assert result.stderr.startswith("Error: Expected ")


@pytest.mark.parametrize("high", [10**400, float("inf"), float("nan"), np.float64(np.inf), "3"])
def test_a_range_that_is_not_finite_is_refused_in_python_too(high):
    with pytest.raises(UserError, match=r"low (and|<) high"):
        Attribute(0.0, high, "gravity").parameter("gravity")
    with pytest.raises(UserError, match="Expected finite low < high"):
        Parameter("gravity", 0.0, high)


def test_the_largest_values_are_taken(file):
    file.write_text(
        written(
            {
                **PLAIN,
                "episodes": "2",
                "agent_timeout": "1e6",
                "timeout": "1e300",
                "parameters": f"{{{'n' * 100} = {{kind = 'attribute', integer = true, "
                f"low = {-(2**51)}, high = {2**51}, paths = 'gravity'}}}}",
            }
        )
    )
    application = read_application(file)
    assert isinstance(application, GymnasiumApplication)
    values = application.parameters.physical(np.array([[-1.0], [1.0]], np.float32))
    np.testing.assert_array_equal(values.ravel(), [-(2**51) - 0.5, 2**51 + 0.5])
