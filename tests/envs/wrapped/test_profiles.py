"""Values that change over an episode: their curves, who gets them, and that they repeat."""

from __future__ import annotations

import numpy as np
import pytest
from wrapped_toys import Reach, approach, balance, cart_pole, swing

from sada_gym import GymnasiumApplication, Oracle
from sada_gym.analyses.plots.curves import curves
from sada_gym.analyses.plots.style import png
from sada_gym.envs.wrapped import (
    ActionDelay,
    ActionGain,
    ActionNoise,
    Attribute,
    Force,
    Function,
    Keyword,
    ObservationDelay,
    ObservationDropout,
    ObservationNoise,
    RepeatedActions,
)
from sada_gym.envs.wrapped.profiles import Profile
from sada_gym.envs.wrapped.toml import binding_of
from sada_gym.evaluations import Evaluations


def blow(env, strength):
    env.state = np.asarray(env.state) + np.array([0.0, strength, 0.0, 0.0])


def set_wind(env, value):
    env.wind = value


def reaching(parameters, **changes):
    arguments = {
        "agent": approach,
        "agent_id": "approach",
        "score": ("length", 10),
        "fooling_threshold": 0.5,
        "max_steps": 10,
    }
    return GymnasiumApplication(Reach, parameters=parameters, **arguments | changes)


def seen(application, mu, look):
    """What `look` sees of the environment before each step."""
    (episode,) = application.episodes(np.array([mu], np.float32), [0]).running
    values = []
    while not episode.ended:
        episode.step(0)
        values.append(look(episode.environment.unwrapped))
    return values


def test_a_curve_goes_through_its_knots():
    for curve in ("linear", "cubic"):
        profile = Profile((0.0, 3.0, 1.0, 1.0), 31, curve)
        assert [profile(step) for step in (0, 10, 20, 30, 99)] == [0.0, 3.0, 1.0, 1.0, 1.0]
        between = np.array([profile(step) for step in range(31)])
        assert between.min() == 0.0
        assert between.max() == 3.0
        assert (np.diff(between[:11]) > 0.0).all()
    assert Profile((0.0, 3.0), 4)(1) == pytest.approx(1.0)
    steps = Profile(("a", "b", "c"), 6, "steps")
    assert [steps(step) for step in range(7)] == ["a", "a", "b", "b", "c", "c", "c"]
    whole = Profile((0, 1), 5, "linear", whole=True)
    assert [whole(step) for step in range(5)] == [0, 0, 1, 1, 1]
    assert Profile((1.0, 2.0, 3.0), 2, "cubic")(1) == 3.0


@pytest.mark.parametrize(
    "binding",
    [Attribute(-1.0, 1.0, knots=3), Function(-1.0, 1.0, set=set_wind, knots=3)],
)
def test_an_environment_has_the_value_of_each_step(binding):
    application = reaching({"wind": binding})
    assert application.parameters.names == ("wind[0]", "wind[1]", "wind[2]")
    expected = [Profile((-1.0, 1.0, 0.0), 10)(step) for step in range(10)]
    found = seen(application, [-1.0, 1.0, 0.0], lambda world: world.wind)
    assert found == expected[: len(found)]
    assert len(found) > 3


def test_a_factor_multiplies_what_the_reset_put_there():
    speed = {"speed": Attribute(0.0, 4.0, factor=True, knots=2, curve="steps")}
    found = seen(reaching(speed), [-1.0, 0.0], lambda world: world.speed)
    assert found == [0.0] * 5 + [0.2] * 5
    nominal = reaching({"speed": Attribute(0.5, 1.5, factor=True, knots=2)}).nominal
    assert nominal.tolist() == [0.0, 0.0]


def test_what_follows_from_a_value_follows_it_in_each_step():
    application = cart_pole(
        parameters={"masspole": Attribute(0.1, 0.5, knots=2)},
        derived={"total_mass": "masspole + masscart", "polemass_length": "masspole * length"},
        max_steps=20,
    )
    pairs = seen(application, [-1.0, 1.0], lambda world: (world.masspole, world.total_mass))
    assert len({mass for mass, _ in pairs}) == len(pairs)
    assert all(total == mass + 1.0 for mass, total in pairs)


KINDS = {
    "noise": (ObservationNoise, 0.0, 1.0),
    "delay": (ObservationDelay, 0, 4),
    "dropout": (ObservationDropout, 0.0, 1.0),
    "action-noise": (ActionNoise, 0.0, 1.0),
    "action-delay": (ActionDelay, 0, 4),
    "repeats": (RepeatedActions, 1, 5),
    "gain": (ActionGain, 0.0, 2.0),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_curve_that_stays_the_same_is_the_constant(kind):
    binding, low, high = KINDS[kind]

    def scores(**knots):
        application = GymnasiumApplication(
            "Pendulum-v1",
            agent=swing,
            parameters={"it": binding(low, high, **knots)},
            score=("return", -600.0, 0.0),
            fooling_threshold=0.5,
            max_steps=60,
        )
        mu = np.full((1, len(application.parameters)), 0.5, np.float32)
        changed = mu.copy()
        changed[0, 0] = -1.0
        both = np.concatenate([mu, changed])
        return application.evaluate(both, [3, 3]).score

    constant = scores()
    for curve in ("linear", "cubic", "steps"):
        same, changed = scores(knots=3, curve=curve)
        assert same == constant[0]
        assert changed != constant[0]


def test_a_force_for_some_steps_has_its_curve_over_these():
    pushes = []
    force = Force(0.0, 1.0, apply=lambda env, strength: pushes.append(strength), start=3, steps=4)
    application = cart_pole(parameters={"push": Force(**vars(force) | {"knots": 4})}, max_steps=20)
    pushes.clear()
    seen(application, [-0.5, 0.0, 0.5, 1.0], lambda world: None)
    assert pushes == [0.25, 0.5, 0.75, 1.0]


def windy(**changes):
    return cart_pole(
        agent=balance,
        parameters={
            "wind": Force(-0.4, 0.4, apply=blow, knots=3, curve="cubic"),
            "noise": ObservationNoise(0.0, 0.3, knots=2),
        },
        feasible="wind[0] < 0.3 or wind[1] < 0",
        agent_id="balance",
        max_steps=80,
        score=("length", 80),
        **changes,
    )


@pytest.mark.long
def test_worlds_are_the_same_with_two_workers_alone_and_in_a_film(tmp_path):
    mu = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 5)).astype(np.float32)
    application, scores = windy(), []
    for workers, store in (
        (1, None),
        (2, tmp_path / "store.sqlite"),
        (1, tmp_path / "store.sqlite"),
    ):
        with Oracle(windy(), budget=12, seed=3, workers=workers, store=store) as oracle:
            scores.append(oracle(mu).tolist())
            seeds = oracle.record.seed.tolist()
    assert scores[0] == scores[1] == scores[2]
    assert len(set(scores[0])) > 5
    place = application.permits(mu).argmax()
    alone = application.evaluate(mu[[place]], [seeds[place]]).score[0]
    frames, score = application.replay(mu[place], seeds[place])
    assert scores[0][place] == alone == score
    assert len(frames) > 1


def test_the_region_knows_knots():
    application = windy()
    mu = np.random.default_rng(0).uniform(-1.0, 1.0, (100, 5)).astype(np.float32)
    values = application.parameters.physical(mu)
    assert application.permits(mu).tolist() == ((values[:, 0] < 0.3) | (values[:, 1] < 0)).tolist()


@pytest.mark.parametrize(
    ("binding", "message"),
    [
        (Keyword(0.0, 1.0, name="speed", knots=3), "may change during an episode, got 'it'"),
        (Attribute(0.0, 1.0, paths="wind", knots=1), "knots of 'it'"),
        (Attribute(0.0, 1.0, paths="wind", knots=3, curve="round"), "curve of 'it'"),
        (Attribute(0.0, 1.0, paths="wind", curve="cubic"), "Expected knots with curve="),
        (Attribute(0.0, 1.0, paths="wind", knots=3, over=2), "over which its knots lie"),
        (Attribute(choices=(1.0, 2.0), paths="wind", knots=3), "nothing lies between others"),
        (Attribute(0, 360, paths="wind", angle=True, knots=3), "nothing lies between others"),
        (Function(0.0, 1.0, set=set_wind, after_reset=False, knots=3), "after_reset=True of 'it'"),
    ],
)
def test_bad_knots_are_told(binding, message):
    with pytest.raises(ValueError, match=message):
        reaching({"it": binding})


def test_episodes_without_a_limit_need_the_steps():
    wind = {"wind": Attribute(-1.0, 1.0, knots=3)}
    with pytest.raises(ValueError, match="Expected over= of 'wind'"):
        reaching(wind, max_steps="own")
    wind = {"wind": Attribute(-1.0, 1.0, knots=3, over=40)}
    assert reaching(wind, max_steps="own").settings["parameters"]["wind"]["over"] == 40


def test_a_file_may_ask_for_knots(tmp_path):
    table = {"kind": "observation-noise", "low": 0.0, "high": 1.0, "knots": 4, "curve": "steps"}
    assert binding_of("n", table, tmp_path) == ObservationNoise(0.0, 1.0, knots=4, curve="steps")


def test_knots_have_a_density_each():
    wind = Attribute(-1.0, 1.0, knots=3, nominal={"normal": [0.0, 0.2]})
    application = reaching({"wind": wind})
    drawn = application.density.sample(200, np.random.default_rng(0))
    assert drawn.std(axis=0) == pytest.approx([0.2] * 3, rel=0.3)


@pytest.mark.parametrize(("form", "points"), [("linear", 3), ("steps", 4)])
def test_curves_are_drawn(form, points):
    wind = Attribute(-1.0, 1.0, paths="wind", unit="N", knots=3, curve=form)
    names = {
        "masses[0]": Attribute(0.0, 1.0, paths="speed"),
        "masses[1]": Attribute(0.0, 1.0, paths="reward"),
    }
    application = reaching({"wind": wind, **names})
    assert [*application.curves] == ["wind"]
    mu = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 5)).astype(np.float32)
    worlds = Evaluations(mu, (mu[:, 1] + 1.0) / 2.0, np.arange(50))
    figure = curves(application.parameters, application.curves, worlds, 0.3)
    (axes,) = [axes for axes in figure.axes if axes.get_visible()]
    (passes, fails) = [line.get_ydata() for line in axes.lines]
    assert len(fails) == points  # steps hold to the end
    assert fails[1] < -0.4 < passes[1]
    assert axes.get_ylabel() == "wind (N)"
    assert png(figure).startswith(b"\x89PNG")
