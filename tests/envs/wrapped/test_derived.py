"""Attributes that follow from others are found, told, and computed in every world."""

from __future__ import annotations

import pickle
from contextlib import closing
from dataclasses import dataclass, field

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit

from sada_gym.envs.wrapped import Attribute, Function, GymnasiumApplication, Keyword
from sada_gym.envs.wrapped.bindings import Config
from sada_gym.envs.wrapped.toml import read_application
from sada_gym.errors import Notice, UserError
from tests.support.wrapped_toys import cart_pole

MASS = 2.0
POLE = {"total_mass": "masspole + masscart", "polemass_length": "masspole * length"}


@dataclass
class Body:
    mass: float = 2.0
    radius: float = 0.5
    inertia: float = field(init=False)

    def __post_init__(self):
        self.inertia = self.mass * self.radius**2 / 2


class Toy(gym.Env):
    """Computes attributes in all the ways that a constructor may."""

    observation_space = spaces.Box(-1.0, 1.0, (1,))
    action_space = spaces.Discrete(2)
    drag = 0.25

    def __init__(self, mass=MASS, cart=1.0):
        self.config = {"density": 3.0}
        self.params = {"a b": 1.0, "gain": 2.0}
        self.body = Body()
        length = 0.5
        self.total = mass + cart
        self.length = float(length)
        self.mass, self.cart = mass, cart
        half = self.length / 2
        self.inertia, self.unused = self.mass * half**2, self.mass
        self.inertia += self.cart
        self.period = 2 * np.pi * np.sqrt(self.length / 9.8)
        self.slow = self.drag * self.period
        self.weights = np.array([self.mass, 1.0])
        self.power = self.params["gain"] * self.config["density"]
        self.set_up(length)
        self.limit = spaces.Box(-self.mass, self.mass)

    def set_up(self, height):
        self.height = self.length + 1.0
        self.rate = self.doubled

    @property
    def doubled(self):
        return 2 * self.mass

    @property
    def lively(self):
        return 3 * self.mass

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.momentum = self.mass * self.cart
        self.place = self.np_random.uniform() * self.length
        return np.zeros(1, np.float32), {}

    def step(self, action):
        used = (
            self.total, self.inertia, self.period, self.slow, self.weights, self.power,
            self.height, self.rate, self.momentum, self.place, self.body.inertia, self.lively,
        )  # fmt: skip
        return np.zeros(1, np.float32), float(len(used)), True, False, {}


class Reader(Toy):
    """A base computes what its subclass lets a parameter set."""

    def __init__(self):
        super().__init__()
        self.third = self.total / 3

    def step(self, action):
        return super().step(self.third)


def refuse_other_rests(env, **kwargs):
    if env.bounce > 3.0:
        raise RuntimeError("too high")
    return Toy.reset(env, **kwargs)


def wrapped():
    return gym.wrappers.TransformReward(TimeLimit(Toy(), 5), float)


def application(parameters, environment=Toy, **kwargs):
    return GymnasiumApplication(
        environment,
        agent=lambda seen: 0,
        parameters=parameters,
        score=("length", 5),
        fooling_threshold=0.5,
        agent_id="any",
        max_steps=5,
        **kwargs,
    )


def world(application, mu=1.0, seed=0):
    env, keywords = application.world(np.full(len(application.parameters), mu, np.float32), seed)
    with closing(env):
        env.reset(**keywords)
        return env.unwrapped


@pytest.mark.parametrize(
    ("path", "stale"),
    [
        ("mass", {
            "total": "mass + cart", "inertia": "mass * (length / 2) ** 2 + cart", "weights": "",
            "rate": "doubled",
        }),
        ("length", {
            "inertia": "mass * (length / 2) ** 2 + cart",
            "period": "2 * 3.141592653589793 * sqrt(length / 9.8)",
            "slow": "drag * period", "height": "length + 1.0",
        }),
        ("drag", {"slow": "drag * period"}),
        ("body.mass", {"body.inertia": "body.mass * body.radius ** 2 / 2"}),
        ('params["gain"]', {"power": "params['gain'] * config['density']"}),
        ("params.gain", {"power": "params['gain'] * config['density']"}),
        ('params["a b"]', {}),
        ("place", {}),
        ("momentum", {}),
    ],
)  # fmt: skip
@pytest.mark.parametrize("environment", [Toy, wrapped])
def test_what_a_constructor_computed_is_found_with_its_expression(environment, path, stale):
    given = {"x": Attribute(2.5, 4.0, paths=path)}
    if stale:
        verb = "were" if len(stale) > 1 else "was"
        with pytest.warns(
            Notice, match=rf"\w {verb} computed in the constructor, without the para"
        ):
            found = application(given, environment)
    else:
        found = application(given, environment)
    assert found.stale == stale


def test_expressions_that_were_found_make_the_attributes_right():
    with pytest.warns(Notice) as told:
        found = application({"length": (1.0, 2.0)}, Reader)
    assert "derived = { inertia = " in str(told[0].message)
    fixed = application({"length": (1.0, 2.0)}, Reader, derived=found.stale)
    assert fixed.stale == {}
    env = world(fixed)
    assert (env.length, env.height, env.inertia) == (2.0, 3.0, 3.0)
    assert env.slow == pytest.approx(0.25 * env.period)
    assert env.period == pytest.approx(2 * np.pi * np.sqrt(2.0 / 9.8))


def test_the_attributes_of_a_base_are_followed_through_a_subclass():
    with pytest.warns(Notice):
        found = application({"cart": (2.0, 3.0)}, Reader).stale
    assert found["third"] == "total / 3"
    assert found["total"] == "mass + cart"


def test_what_follows_is_not_told():
    def set_all(env, value):
        env.mass = value
        env.total, env.inertia = value + env.cart, value * (env.length / 2) ** 2 + env.cart
        env.weights, env.rate = np.array([value, 1.0]), env.doubled

    for binding in (Keyword(3.0, 4.0), Function(3.0, 4.0, set=set_all)):
        assert application({"mass": binding}).stale == {}
    given = {"mass": (3.0, 4.0), "later": Function(5.0, 6.0, set=leave)}
    assert application(given).stale == {}


def test_a_configuration_is_followed_too():
    with pytest.warns(Notice, match="power"):
        found = application({"density": Config(4.0, 5.0)})
    assert found.stale == {"power": "params['gain'] * config['density']"}


def test_without_source_a_second_construction_tells_of_keywords():
    space = {"Toy": Toy, "np": np}
    exec(
        "class Hidden(Toy):\n"
        "    def __init__(self, rest=1.0):\n"
        "        super().__init__()\n"
        "        self.rest = rest\n"
        "        self.bounce = 3 * rest\n",
        space,
    )
    with pytest.warns(Notice, match=r"Set bounce by a Function, or the parameters by a Keyword\."):
        found = application({"rest": Attribute(2.0, 3.0)}, space["Hidden"])
    assert found.stale == {"bounce": ""}
    space["Hidden"].reset = refuse_other_rests
    assert application({"rest": Attribute(2.0, 3.0)}, space["Hidden"]).stale == {}


@pytest.mark.parametrize("mu", [-1.0, 0.3, 1.0])
def test_cart_pole_stays_one_pole(mu):
    pole = cart_pole(parameters={"length": (0.2, 2.0), "masspole": (0.05, 0.5)}, derived=POLE)
    env = world(pole, mu)
    assert env.polemass_length == pytest.approx(env.masspole * env.length)
    assert env.total_mass == pytest.approx(env.masspole + env.masscart)
    assert pole.world(None, 0)[0].unwrapped.polemass_length == 0.05
    assert pole.settings["derived"] == POLE
    with pytest.warns(Notice):
        plain = cart_pole(parameters={"length": (0.2, 2.0), "masspole": (0.05, 0.5)})
    assert "derived" not in plain.settings
    mus = np.full((4, 2), -1.0)
    assert np.any(plain.evaluate(mus, range(4)).score != pole.evaluate(mus, range(4)).score)
    again = pickle.loads(pickle.dumps(pole.episode_spec.derived))
    assert again == pole.episode_spec.derived


def test_names_are_attributes_or_parameters_and_the_order_is_found():
    env = world(
        application(
            {"pole mass": Attribute(3.0, 4.0, paths="mass"), "noise": Function(1, 2, set=leave)},
            derived={
                "slow": "total * 2", "total": "mass + pole_mass + noise", "weights[1]": "slow / 2",
                'params["gain"]': "weights[0] + drag", "body.inertia": "params.gain + 1",
                "rate": "4", "inertia": "2 * pole_mass",
            },
        )
    )  # fmt: skip
    assert (env.total, env.slow, env.weights[1], env.params["gain"]) == (10.0, 20.0, 10.0, 2.25)
    assert (env.body.inertia, env.rate, env.inertia) == (3.25, 4.0, 8.0)


def leave(env, value):
    pass


@pytest.mark.parametrize(
    ("derived", "said"),
    [
        ({"totl": "mass"}, "Did you mean total"),
        ({"total": "mas + 1"}, r"name in derived total = 'mas \+ 1'.*Did you mean mass"),
        ({"total": "slow", "slow": "2 * total"}, "got a circle: (total from slow|slow from total)"),
        ({"total": "total + 1"}, "got a circle: total from total"),
        ({"mass": "cart"}, "'mass' either in derived or set by a parameter"),
        ({"total": "mass +"}, "Expected an expression such as 'masspole \\* length' as derived"),
        ({"total": "__import__('os').getcwd()"}, "function in derived"),
        ({"total": "[mass][0]"}, "Expected arithmetic and comparisons in derived"),
        ({"total": 3.0}, "expressions by attribute"),
        ("total = mass", "expressions by attribute"),
        ({"total": "mass / 0"}, "to give a number.*ZeroDivisionError"),
        ({"total": "step"}, "to give a number"),
        ({"step": "mass"}, "attribute of Toy in derived"),
        ({"a b": "mass"}, "Expected an attribute such as"),
    ],
)
def test_bad_expressions_are_refused_with_a_sentence(derived, said):
    with pytest.raises(UserError, match=said):
        application({"mass": (3.0, 4.0)}, derived=derived)


def test_mujoco_follows_its_masses():
    def body(env):
        return env.model.body_subtreemass[1] / env.model.body_mass[1:].sum()

    given = {"mass": Attribute(0.5, 2.0, factor=True, paths="model.body_mass")}
    with pytest.warns(
        Notice, match=r'paths = \["model.body_mass", "model.body_inertia"\], factor = true'
    ):
        found = application(given, "Hopper-v5")
    assert body(world(found)) == pytest.approx(1.0)
    both = ("model.body_mass[1]", "model.body_inertia[1]")
    given = {"mass": Attribute(0.5, 2.0, factor=True, paths=both)}
    env, plain = world(application(given, "Hopper-v5")), gym.make("Hopper-v5").unwrapped
    assert env.model.body_inertia[1] == pytest.approx(2 * plain.model.body_inertia[1])
    assert body(env) == pytest.approx(1.0)
    assert not np.array_equal(env.model.dof_M0, plain.model.dof_M0)
    before = plain.model.body_invweight0.copy()
    mujoco.mj_setConst(plain.model, mujoco.MjData(plain.model))
    assert np.array_equal(before, plain.model.body_invweight0)


def test_a_file_says_the_same(tmp_path):
    file = tmp_path / "pole.toml"
    file.write_text(
        'environment = "CartPole-v1"\nagent = "tests.support.wrapped_toys:balance"\n'
        'score = ["return", 0.0, 500.0]\nfooling_threshold = 0.5\nagent_id = "by hand"\n'
        "[parameters]\nlength = [0.2, 2.0]\nmasspole = [0.05, 0.5]\n"
        '[derived]\ntotal_mass = "masspole + masscart"\npolemass_length = "masspole * length"\n'
    )
    parameters = {"length": (0.2, 2.0), "masspole": (0.05, 0.5)}
    assert (
        read_application(file).settings == cart_pole(parameters=parameters, derived=POLE).settings
    )
    file.write_text(file.read_text().partition("[derived]")[0].replace("[p", 'derived = "x"\n[p'))
    with pytest.raises(UserError, match=r"Expected .derived. in .* to be a table"):
        read_application(file)


def test_a_parameter_may_have_the_name_of_what_holds_an_attribute():
    given = {"body": Function(1.0, 2.0, set=leave)}
    assert world(application(given, derived={"body.inertia": "body.mass"})).body.inertia == 2.0
