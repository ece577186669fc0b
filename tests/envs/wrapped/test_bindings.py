"""Tests of what parameters set."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
import wrapped_toys as toys
from gymnasium.envs.classic_control import AcrobotEnv, CartPoleEnv
from wrapped_toys import Reach, cart_pole, pendulum, reach

from sada_gym.envs.wrapped import (
    ActionDelay,
    Attribute,
    Config,
    Function,
    Keyword,
    ObservationDelay,
    ObservationDropout,
    RepeatedActions,
    ResetOption,
)


def env_at(application, mu, seed=0):
    """The environment of one episode in the world of mu."""
    return application.episodes(np.array([mu], np.float32), [seed]).running[0].env.unwrapped


class Reader(CartPoleEnv):
    """It reads its gravity when it is reset, and overwrites its length there."""

    def reset(self, **kwargs):
        self.read = self.gravity
        self.length = 0.5
        self.gusts = [0.0, 1.0]
        return super().reset(**kwargs)

    @property
    def fixed(self):
        return 1.0


class Configured(Reach):
    """It has a dictionary of settings, part of which is shared by the class."""

    config = {"speed": 0.1, "goal": {"place": 1.0}}  # noqa: RUF012 - the mistake under test


def make_reader(render_mode=None):
    return gym.wrappers.TimeLimit(Reader(render_mode=render_mode), 50)


def test_a_name_finds_a_keyword_before_an_attribute():
    application = pendulum(parameters={"g": (5.0, 15.0), "m": (0.5, 2.0)})
    kinds = [type(binding) for binding in application.episode_spec.bindings.values()]
    assert kinds == [Keyword, Attribute]
    env = env_at(application, [1.0, -1.0])
    assert (env.g, env.m) == (15.0, 0.5)


def test_an_attribute_is_set_before_reset_and_again_where_reset_changed_it():
    application = cart_pole(make_reader, parameters={"gravity": (5.0, 20.0), "length": (0.2, 2.0)})
    env = env_at(application, [1.0, 1.0])
    assert env.read == 20.0
    assert env.length == 2.0


def test_what_exists_after_reset_only_is_set_then():
    application = cart_pole(make_reader, parameters={"wind": Attribute(0.0, 2.0, "gusts[1]")})
    assert env_at(application, [1.0]).gusts == [0.0, 2.0]


@pytest.mark.parametrize("path", ["gusts", "missing.gravity", "length.real.x", "gravity[0]"])
def test_a_path_that_leads_nowhere_gets_a_sentence(path):
    with pytest.raises(ValueError, match=r"found no|a single value at 'gusts'"):
        cart_pole(make_reader, parameters={"here": Attribute(0.0, 1.0, path)})


@pytest.mark.parametrize(
    "path",
    ["", "a..b", "a[x]", "a b", "a.", "[0]", "a[]", "a[0,]", "a[::0]", "a['x]", "a[0]b", "a[1.5]"],
)
def test_a_path_that_is_none_gets_a_sentence(path):
    with pytest.raises(ValueError, match="an attribute such as 'length'"):
        cart_pole(parameters={"here": Attribute(0.0, 1.0, path)})


def test_several_attributes_get_one_value_and_entries_are_attributes():
    application = cart_pole(parameters={"mass": Attribute(1.0, 3.0, ("masscart", "total_mass"))})
    env = env_at(application, [1.0])
    assert env.masscart == env.total_mass == 3.0


def test_a_list_that_the_class_shares_is_copied_first():
    application = cart_pole(
        "Acrobot-v1",
        agent=lambda seen: 2,
        parameters={"torque": Attribute(2.0, 3.0, "AVAIL_TORQUE[2]")},
        score=("return", -500.0, 0.0),
        max_steps=5,
    )
    assert env_at(application, [1.0]).AVAIL_TORQUE == [-1.0, 0.0, 3.0]
    assert [*AcrobotEnv.AVAIL_TORQUE] == [-1.0, 0.0, 1]


def test_a_property_without_a_setter_gets_a_sentence():
    with pytest.raises(ValueError, match=r"'fixed' to be settable to 2.0, got AttributeError"):
        cart_pole(make_reader, parameters={"fixed": (2.0, 3.0)})


def test_an_unknown_name_gets_a_list_of_what_there_is():
    with pytest.raises(ValueError, match="Did you mean g") as caught:
        pendulum(parameters={"gg": (5.0, 15.0)})
    assert "Keywords: g." in str(caught.value)
    assert "max_torque" in str(caught.value)


def test_keywords_reach_the_constructor_and_are_checked():
    application = reach(parameters={"pace": Keyword(0.1, 0.3, name="speed")})
    assert env_at(application, [1.0]).speed == 0.3
    with pytest.raises(ValueError, match=r"keyword of Reach .*'pace'"):
        reach(parameters={"pace": Keyword(0.1, 0.3)})
    with pytest.raises(ValueError, match="Leave it out of env_kwargs"):
        reach(env_kwargs={"speed": 0.1})


def test_a_constructor_that_refuses_a_value_gets_a_sentence():
    pytest.importorskip("Box2D")
    with pytest.raises(ValueError, match=r"LunarLander-v3 to be made with .*AssertionError"):
        cart_pole(
            "LunarLander-v3",
            parameters={"gravity": (-30.0, -4.0)},
        )


def test_reset_gets_options():
    application = reach(parameters={"start": ResetOption(0.0, 1.0)})
    assert env_at(application, [1.0]).options == {"start": 1.0}


def test_entries_of_a_configuration_are_set_in_a_copy():
    application = reach(
        Configured,
        parameters={"speed": Config(0.1, 0.5), "place": Config(0.0, 3.0, name="goal.place")},
    )
    assert env_at(application, [1.0, 1.0]).config == {"speed": 0.5, "goal": {"place": 3.0}}
    assert Configured.config == {"speed": 0.1, "goal": {"place": 1.0}}
    with pytest.raises(ValueError, match="Did you mean speed"):
        reach(Configured, parameters={"speeed": Config(0.1, 0.5)})
    with pytest.raises(ValueError, match="Reach to have a dictionary `config`"):
        reach(parameters={"speed": Config(0.1, 0.5)})


def test_env_kwargs_are_not_shared_between_episodes():
    given = {"config": {"speed": [0.1]}}

    class Writing(Reach):
        def __init__(self, config):
            super().__init__(config["speed"][0])
            config["speed"][0] += 1.0

    application = reach(Writing, parameters={"wind": (0.0, 0.1)}, env_kwargs=given)
    assert env_at(application, [0.0]).speed == env_at(application, [0.0]).speed == 0.1
    assert given == {"config": {"speed": [0.1]}}


@pytest.mark.parametrize(("after", "length"), [(True, 2.0), (False, 0.5)])
def test_a_function_of_ones_own_is_called_once(after, length):
    calls = []

    def lengthen(env, value):
        calls.append(value)
        env.length = value

    application = cart_pole(
        make_reader,
        parameters={"longer": Function(1.0, 2.0, set=lengthen, after_reset=after)},
    )
    calls.clear()
    assert env_at(application, [1.0]).length == length
    assert calls == [2.0]


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (None, "a function set"),
        (lambda env, value: 1 / 0, "function of 'mine' to set .*, got ZeroDivisionError"),
    ],
)
def test_a_bad_function_gets_a_sentence(function, message):
    with pytest.raises(ValueError, match=message):
        cart_pole(parameters={"mine": Function(1.0, 2.0, set=function)})


def test_choices_and_whole_numbers_take_equal_parts():
    choice = Keyword(choices=("low", "mid", "high"))
    assert [choice.value(x) for x in (0.0, 0.99, 1.0, 2.5, 3.0)] == [
        "low",
        "low",
        "mid",
        "high",
        "high",
    ]
    whole = Keyword(2, 4, integer=True)
    parameter = whole.parameter("lanes")
    values = [whole.value(x) for x in np.linspace(parameter.low, parameter.high, 3_001)]
    counts = np.bincount(values)
    assert [*counts[:2]] == [0, 0]
    assert np.ptp(counts[2:]) <= 1
    assert parameter.choices == ("2", "3", "4")


@pytest.mark.parametrize(
    ("binding", "message"),
    [
        (Keyword(choices=("one",)), "at least two choices"),
        (Keyword(choices="dry"), "at least two choices"),
        (Keyword(choices=("dry", "dry")), "that read differently, got 'dry' 2 times"),
        (Keyword(choices=(1, "1")), "that read differently"),
        (Keyword(0.0, 90.0, angle=True), "360 degrees or 2 pi apart, .* got low=0 and high=90"),
        (Keyword(0.0, 360.0, angle=True, integer=True), "neither integer nor log"),
        (Keyword(0.0, 6.28, angle=True, nominal={"normal": [1, 2]}), "in degrees, got one in rad"),
        (Keyword(0.0, 1.0, choices=(1, 2)), "either choices or low and high"),
        (Keyword(0.5, 2.0, integer=True), "whole numbers as low and high"),
        (Keyword("a", 2.0), "numbers as low and high"),
        (Keyword(1.0, 2.0, log="yes"), "log of 'mine' to be True or False, got 'yes'"),
        (Attribute(1.0, 2.0, factor=1), "factor of 'mine' to be True or False, got 1"),
        (Keyword(), "numbers as low and high"),
        (Keyword(3, 3, integer=True), "low < high"),
        (Keyword(0.0, np.nan), "low < high"),
    ],
)
def test_a_bad_range_gets_a_sentence(binding, message):
    with pytest.raises(ValueError, match=message):
        binding.parameter("mine")


@pytest.mark.parametrize(
    "given",
    [
        ["dry", "wet"],
        np.array(["dry", "wet"]),
        {"dry": 1, "wet": 2}.keys(),
        {1: "dry", 2: "wet"}.values(),
    ],
)
def test_choices_may_be_any_collection_with_an_order(given):
    binding = Keyword(choices=given)
    assert binding.choices == ("dry", "wet")
    assert type(binding.choices[0]) is str
    assert binding.settings["choices"] == ["dry", "wet"]


@pytest.mark.parametrize("given", [{"dry", "wet"}, {"dry": 1, "wet": 2}, iter("ab"), b"ab", 3])
def test_choices_without_an_order_are_refused(given):
    with pytest.raises(TypeError, match=r"Expected choices in an order, .* got \w+\. Write a tup"):
        Keyword(choices=given)


def test_choices_of_several_lines_have_names_in_one():
    binding = Keyword(choices=("..#\n#..", "caf\udce9", "10\u00a0km/h", 1, True))
    parameter = binding.parameter("map")
    assert parameter.choices == (r"..#\n#..", r"caf\udce9", "10\u00a0km/h", "1", "True")
    assert binding.value(0.5) == "..#\n#.."
    assert binding.settings["choices"][1] == r"caf\udce9"


class Melting(Reach):
    """It breaks its own ice where it is fast."""

    def __init__(self, tiles=None, bag=None, speed=0.1):
        super().__init__(speed)
        self.tiles, self.bag = tiles, bag

    def step(self, action):
        answer = super().step(action)
        whole = self.tiles[0] == "ice" and not self.bag and not self.options["rocks"]
        if self.speed > 0.15:
            self.tiles[0] = "hole"
            self.bag.append(1)
            self.options["rocks"].append(1)
        return *answer[:2], True, *answer[3:4], {"is_success": whole}


def test_an_environment_may_write_into_what_it_is_given():
    application = reach(
        Melting,
        parameters={
            "tiles": Keyword(choices=(["ice", "ice"], ["ice", "snow"])),
            "rocks": ResetOption(choices=([], ())),
            "speed": (0.05, 0.2),
        },
        env_kwargs={"bag": []},
        max_steps=1,
    )
    slow, fast = [-0.5, -0.5, -1.0], [-0.5, -0.5, 1.0]
    mu = np.array([slow, fast, slow, fast, slow], np.float32)
    for _ in range(2):
        assert application.evaluate(mu, range(5)).score.tolist() == [1.0] * 5


def test_an_angle_goes_all_around():
    degrees = Keyword(-180.0, 180.0, angle=True).parameter("heading")
    assert (degrees.low, degrees.high, degrees.unit) == (-180.0, 180.0, "deg")
    assert degrees.directions[1] == "around 90°"
    radians = Keyword(-np.pi, np.pi, directions=("north", "east", "south", "west"))
    parameter = radians.parameter("heading")
    assert (parameter.low, parameter.high) == (-180.0, 180.0)
    assert radians.value(90.0) == pytest.approx(np.pi / 2)
    assert radians._place(1.5 * np.pi) == pytest.approx(-90.0)


@pytest.mark.parametrize(
    ("binding", "likely"),
    [
        (Keyword(0.0, 360.0, unit="deg"), True),
        (Keyword(-3.14159, 3.14159), True),
        (Keyword(0.0, 6.28, unit="rad"), True),
        (Keyword(0.0, 360.0), False),
        (Keyword(0.0, 360.0, unit="deg", angle=True), False),
        (Keyword(choices=("a", "b")), False),
    ],
)
def test_what_looks_like_an_angle_is_asked_about(binding, likely):
    assert binding.looks_like_angle() is likely


def test_settings_say_what_differs_from_the_default():
    assert Attribute(0.5, 2.0, ("a", "b"), unit="m").settings == {
        "kind": "Attribute",
        "low": 0.5,
        "high": 2.0,
        "unit": "m",
        "paths": ["a", "b"],
    }
    assert Function(0.5, 2.0, set=toys.upright).settings["set"] == "wrapped_toys:upright"


def test_a_logarithmic_range_reaches_the_environment():
    application = cart_pole(
        parameters={
            "gravity": Attribute(1.0, 100.0, log=True),
            "steps": Function(1, 1000, set=set_steps, integer=True, log=True),
        }
    )
    env = env_at(application, [0.0, 1.0])
    assert env.gravity == pytest.approx(10.0)
    assert env.steps == 1000
    settings = application.settings["parameters"]
    assert settings["gravity"] == {"kind": "Attribute", "low": 1.0, "high": 100.0, "log": True}
    with pytest.raises(ValueError, match=r"one sign, and not 0, .* 'gravity'"):
        cart_pole(parameters={"gravity": Attribute(0.0, 9.8, log=True)})
    with pytest.raises(ValueError, match="either choices or low and high"):
        cart_pole(parameters={"gravity": Attribute(choices=(1.0, 2.0), log=True)})


def set_steps(env, value):
    env.steps = value


class Slippery(Reach):
    """Its keywords have defaults, and it has a configuration."""

    def __init__(self, speed=0.1, surface="dry", shaky=False, lanes=4):
        super().__init__(speed)
        self.surface, self.shaky, self.lanes = surface, shaky, lanes
        self.config = {"goal": {"place": np.float64(1.0)}}
        self.length, self.half_length = np.float32(0.5), 0.25


@pytest.mark.parametrize(
    ("binding", "value"),
    [
        (Keyword(0.05, 0.2, name="speed"), pytest.approx(0.1)),
        (Keyword(choices=("wet", "dry"), name="surface"), "dry"),
        (Keyword(choices=(1, True, False), name="shaky"), False),
        (Keyword(2, 6, integer=True, name="lanes"), 4),
        (Keyword(1, 60, integer=True, log=True, name="lanes"), 4),
        (Attribute(0.1, 10.0, "length", log=True), pytest.approx(0.5)),
        (Attribute(0.1, 10.0, ("length", "half_length")), None),
        (Attribute(1.0, 2.0, "length"), None),
        (Config(0.0, 2.0, name="goal.place"), 1.0),
        (ResetOption(0.0, 2.0), None),
        (ResetOption(0.0, 2.0, nominal=0.5), 0.5),
        (Function(1.0, 2.0, set=set_steps), None),
        (Attribute(0.0, 1.0, "length", nominal=0.75), 0.75),
        (Keyword(choices=("wet", "dry"), name="surface", nominal="wet"), "wet"),
        (ObservationDelay(0, 3), 0),
        (ActionDelay(1, 3), None),
        (RepeatedActions(1, 5), 1),
        (ObservationDropout(0.0, 0.5), 0.0),
    ],
)
def test_the_nominal_world_is_what_the_environment_has(binding, value):
    application = reach(Slippery, parameters={"it": binding})
    if value is None:
        assert application.nominal is None
    else:
        assert application.nominal.shape == (1,)
        (values,) = application._values(application.nominal[None])
        assert values == {"it": value}
        assert type(values["it"]) is type(value) or not isinstance(value, bool)


def test_gravity_of_cart_pole_is_known_and_no_score_depends_on_what_is_nominal():
    plain = cart_pole()
    assert plain.parameters.physical(plain.nominal) == pytest.approx([9.8, 0.5])
    other = cart_pole(
        parameters={"gravity": (5.0, 20.0), "length": Attribute(0.2, 2.0, nominal=1.0)}
    )
    assert other.settings == plain.settings
    assert cart_pole(feasible="length > 0.6").nominal is None


@pytest.mark.parametrize(
    "binding",
    [
        Attribute(1.0, 2.0, "length", nominal=3.0),
        Attribute(1.0, 2.0, "length", nominal="1.5"),
        Attribute(1, 3, "length", integer=True, nominal=1.5),
        Attribute(choices=(1.0, 2.0), paths="length", nominal=3.0),
    ],
)
def test_a_nominal_value_outside_the_range_gets_a_sentence(binding):
    with pytest.raises(ValueError, match=r"nominal of 'it' to be (one of|from) .* got"):
        cart_pole(parameters={"it": binding})


SHARED = {"mass": 2.0}


class Rigged(Reach):
    """It holds arrays, lists and dictionaries of numbers."""

    lengths = [1.0, 2.0]  # noqa: RUF012 - the class shares it

    def __init__(self):
        super().__init__()
        self.masses = np.array([1.0, 2.0, 0.0])
        self.friction = np.ones((3, 2), np.float32)
        self.gains = [[1.0, 2.0], [3.0, 4.0]]
        self.params = {"mass": 2.0, "a.b": 1.0, "inner": {"mass": 4.0}}
        self.shared = SHARED
        self.counts = np.array([1, 2])
        self.names = ["a", "b"]
        self.drawn = self.rebuilt = 1.0

    def reset(self, **kwargs):
        result = super().reset(**kwargs)
        self.rebuilt = 1.0
        self.drawn = self.np_random.uniform(1.0, 2.0)
        self.masses[1] = 2.0
        return result


def rigged(*mu, seed=0, **parameters):
    """The environment of one episode in the world of mu."""
    return env_at(reach(Rigged, parameters=parameters), list(mu), seed)


@pytest.mark.parametrize(
    ("path", "read", "expected"),
    [
        ("masses[:]", "masses", [3.0, 3.0, 3.0]),
        ("masses[1:]", "masses", [1.0, 3.0, 3.0]),
        ("masses[-1]", "masses", [1.0, 2.0, 3.0]),
        ("friction[0,1]", "friction", [[1, 3], [1, 1], [1, 1]]),
        ("friction[:, 0]", "friction", [[3, 1], [3, 1], [3, 1]]),
        ("friction[::2,0]", "friction", [[3, 1], [1, 1], [3, 1]]),
        ("friction[2][1]", "friction", [[1, 1], [1, 1], [1, 3]]),
        ("gains[1][0]", "gains", [[1.0, 2.0], [3.0, 4.0]]),
        ("gains[1:]", "gains", [[1.0, 2.0], [3.0, 3.0]]),
        ("lengths[:]", "lengths", [3.0, 3.0]),
        ('params["mass"]', "params['mass']", 3.0),
        ("params['a.b']", "params['a.b']", 3.0),
        ("params.mass", "params['mass']", 3.0),
        ("params.inner.mass", "params['inner']['mass']", 3.0),
    ],
)
def test_a_path_may_have_slices_and_keys(path, read, expected):
    env = rigged(1.0, it=Attribute(1.0, 3.0, path))
    value = eval(f"env.{read}", {"env": env})
    assert np.array_equal(value, expected)
    assert Rigged.lengths == [1.0, 2.0]


@pytest.mark.parametrize(
    ("path", "read", "expected"),
    [
        ("masses[:]", "masses", [2.0, 4.0, 0.0]),
        ("masses", "masses", [2.0, 4.0, 0.0]),
        ("friction[:,1]", "friction", [[1, 2], [1, 2], [1, 2]]),
        ("gains", "gains", [[2.0, 4.0], [6.0, 8.0]]),
        ("gains[0][:]", "gains", [[2.0, 4.0], [3.0, 4.0]]),
        ("lengths", "lengths", [2.0, 4.0]),
        ("params.inner.mass", "params['inner']['mass']", 8.0),
        ("rebuilt", "rebuilt", 2.0),
        ("wind", "wind", 0.0),
    ],
)
def test_a_factor_acts_once_on_what_is_there(path, read, expected):
    application = reach(Rigged, parameters={"it": Attribute(0.5, 2.0, path, factor=True)})
    for _ in range(3):
        env = env_at(application, [1.0])
        assert np.array_equal(eval(f"env.{read}", {"env": env}), expected)
    assert application.parameters.physical(application.nominal) == pytest.approx([1.0])
    assert Rigged.lengths == [1.0, 2.0]


def test_a_factor_acts_on_what_a_reset_draws():
    plain = rigged(0.0, wind=(-0.1, 0.1), seed=3)
    assert rigged(1.0, drawn=Attribute(0.5, 2.0, factor=True), seed=3).drawn == 2.0 * plain.drawn


def test_factors_that_meet_act_once_each():
    env = rigged(
        1.0,
        1.0,
        all=Attribute(0.5, 2.0, "masses[:]", factor=True),
        one=Attribute(0.5, 3.0, "masses[0:2]", factor=True),
    )
    assert env.masses.tolist() == [6.0, 12.0, 0.0]


@pytest.mark.parametrize(
    ("binding", "message"),
    [
        (Attribute(0.5, 2.0, "masses"), r"Name one entry, such as 'masses\[0\]', or all by \[:\]"),
        (Attribute(0.5, 2.0, "params"), r"Name one entry, such as 'params\[\"mass\"\]'"),
        (Attribute(0.5, 2.0, "params", factor=True), "Name one entry"),
        (Attribute(0.5, 2.0, "masses[5:]"), r"an entry at 'masses\[5:\]' .* Fix the slice"),
        (Attribute(0.5, 2.0, "names[:]"), r"numbers at 'names\[:\]'"),
        (Attribute(0.5, 2.0, "names[0]", factor=True), r"numbers at 'names\[0\]'"),
        (Attribute(0.5, 2.0, "counts", factor=True), r"int64, which would round them"),
        (Attribute(0.5, 2.0, "gains[0,1]"), r"found no 'gains\[0,1\]'"),
        (Attribute(0.5, 2.0, "params.speed"), "found no 'params.speed'"),
        (Attribute(0.5, 2.0, "shared.mass", factor=True), "but two share it"),
    ],
)
def test_what_cannot_be_set_or_scaled_gets_a_sentence(binding, message):
    with pytest.raises(ValueError, match=message):
        rigged(0.0, it=binding)
    assert SHARED == {"mass": 2.0}


def test_a_density_of_ordinary_use_is_kept_as_data():
    application = reach(
        Slippery,
        parameters={
            "speed": Keyword(0.05, 0.2, nominal={"normal": [0.1, 0.01]}),
            "surface": Keyword(
                choices=("wet", "dry"), nominal={"values": ["dry", "wet"], "weights": [3, 1]}
            ),
            "lanes": Keyword(2, 6, integer=True, nominal={"uniform": [3, 5]}),
            "wind": (0.0, 0.05),
        },
    )
    assert [*application.density.densities] == ["speed", "surface", "lanes"]
    (values,) = application._values(application.nominal[None])
    assert values == {"speed": pytest.approx(0.1), "surface": "dry", "lanes": 4, "wind": 0.0}
    drawn = application._values(application.density.sample(400, np.random.default_rng(0)))
    assert np.mean([row["surface"] == "dry" for row in drawn]) == pytest.approx(0.75, abs=0.08)
    assert {row["lanes"] for row in drawn} == {3, 4, 5}
    assert "nominal" not in application.settings["parameters"]["speed"]
    assert reach().density is None
    with pytest.raises(ValueError, match="Expected a density as"):
        reach(parameters={"speed": Keyword(0.05, 0.2, nominal={"gauss": [0.1, 0.01]})})
