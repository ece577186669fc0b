"""Every registered environment keeps the contract of DESIGN.md."""

from __future__ import annotations

import inspect
import pickle
import subprocess
import sys
import warnings
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from families import MISSING, SHIPPED, family
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import SyncVectorEnv
from numpy.testing import assert_array_equal
from registry_cases import PurityCase, case_of
from stable_baselines3.common.env_checker import check_env as check_env_sb3

import sada_gym
from sada_gym import envs
from sada_gym.application import Application, Outcomes
from sada_gym.envs import AdversaryEnv, AdversaryVectorEnv
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.foundations.cards import APPLICATIONS, ApplicationCard, cards
from sada_gym.foundations.ids import find_spec
from sada_gym.foundations.lazy import load
from sada_gym.foundations.registration import register_environments
from sada_gym.testing.processes import in_fresh_process
from sada_gym.testing.purity import assert_pure, compare_outcomes, draw_worlds
from sada_gym.testing.rules import check_live_parameters, check_outcomes

IDS = sada_gym.env_ids()
CARD_OF = {env_id: card for card in cards() for env_id in (card.id, *card.track_ids)}
SAME_WORLDS = {card.id: card.track_id(card.same_as) for card in cards() if card.same_as}
"""General ids, and the track that each is by default: the same application.

That it is the same is tested; the rest is then tested on the track alone.
"""
INSTALLED = [card for card in cards() if not card.missing and card.repeatable]
WORLDS = [env_id for env_id in IDS if env_id not in SAME_WORLDS]


def seed_of(env_id: str, seeds: Mapping[str, int]) -> int:
    """The seed that a card has for a track, by its suffix; 0 where it has none."""
    card = CARD_OF[env_id]
    by_id = {card.track_id(suffix): seed for suffix, seed in seeds.items()}
    return by_id.get(env_id, 0)


def brief_seed(env_id: str) -> int:
    return seed_of(env_id, case_of(CARD_OF[env_id].name).brief)


def purity_case(env_id: str) -> PurityCase:
    case = case_of(CARD_OF[env_id].name)
    return case.purity if env_id in SHIPPED else case.purity_elsewhere


def one_step_is_slow(env_id: str) -> bool:
    return case_of(CARD_OF[env_id].name).slow


def with_quick_agent(env_id: str) -> dict[str, Any]:
    """Keywords for tests of the environment's own doing, which any agent shows."""
    case = case_of(CARD_OF[env_id].name)
    agent = {"agent": case.quick_agent()} if case.quick_agent else {}
    return {**case.quick_kwargs, **agent}


def with_shipped_agent_on_one_track(env_id: str) -> dict[str, Any]:
    """Keywords for tests that need each family's shipped agent, but not on each of its tracks."""
    return {} if env_id in SHIPPED else with_quick_agent(env_id)


@pytest.fixture(params=family(WORLDS, *SHIPPED))
def env_id(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def env(env_id: str) -> Iterator[AdversaryEnv]:
    """An environment whose agent is quick."""
    env = gym.make(env_id, render_mode="rgb_array", **with_quick_agent(env_id))
    yield env.unwrapped  # type: ignore[misc]
    env.close()


def proposals(env_id: str, n: int) -> np.ndarray:
    application = sada_gym.make_application(env_id, **with_quick_agent(env_id))
    return draw_worlds(application, n, brief_seed(env_id))[0]


def test_gymnasium_accepts_it_without_a_warning(env: AdversaryEnv) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)


def test_sb3_accepts_it_without_a_warning(env: AdversaryEnv) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env_sb3(env, skip_render_check=False)


# `test_a_general_id_is_its_default_track` compares two instances with the shipped agent
def test_two_instances_agree_exactly(env_id: str) -> None:
    first, second = proposals(env_id, 2)

    def run() -> list[Any]:
        env = gym.make(env_id, **with_quick_agent(env_id))
        steps: list[Any] = [env.reset(seed=3), env.step(first), env.reset(), env.step(second)]
        env.close()
        return steps

    assert data_equivalence(run(), run(), exact=True)


@pytest.mark.filterwarnings("error")
def test_reset_and_step_equal_evaluate(env_id: str) -> None:
    env = gym.make(env_id, **with_shipped_agent_on_one_track(env_id)).unwrapped
    assert isinstance(env, AdversaryEnv)
    (mu,) = proposals(env_id, 1)
    env.reset(seed=11)
    _, reward, terminated, truncated, info = env.step(mu)
    assert type(reward) is float
    assert reward == -info["score"]
    assert (terminated, truncated) == (True, False)
    outcomes = env.application.evaluate([mu], [11])
    assert data_equivalence(info, outcomes.infos[0], exact=True)
    assert info["fooled"] == (info["score"] <= env.application.fooling_threshold)
    assert list(info["parameters"]) == list(env.application.parameters.names)
    env.close()


# test_driving.py and test_racing_frame.py replay longer episodes
def test_replay_gives_frames_and_the_same_score(env: AdversaryEnv, env_id: str) -> None:
    (mu,) = proposals(env_id, 1)
    env.reset(seed=11)
    info = env.step(mu)[4]
    frames, score = env.replay(mu, 11)
    assert score == info["score"]
    assert len(frames) >= 1
    for frame in [*frames, env.render(), env.application.observation(mu, 11)]:
        assert isinstance(frame, np.ndarray)
        assert frame.dtype == np.uint8
        assert frame.ndim == 3
        assert frame.shape[2] == 3


def test_pictures_of_a_bad_seed_are_refused() -> None:
    env, mu = AdversaryEnv(AnalyticApplication()), [0.0, 0.0]
    draws = (env.replay, env.application.render, env.application.observation)
    for draw, seed in product(draws, [-1, 2**31, 1.5, "x"]):
        with pytest.raises(ValueError, match=r"Expected seeds to be ints in \[0, 2\*\*31\)"):
            draw(mu, seed)


# test_adversary_env.py tries other horizons
def test_the_native_batch_equals_the_scalar_environments(env_id: str) -> None:
    horizon = 3
    keywords = with_quick_agent(env_id)
    num_envs = 2 if one_step_is_slow(env_id) else 3
    steps = horizon + 1  # the last one is after the autoreset
    native = gym.make_vec(env_id, num_envs=num_envs, horizon=horizon, **keywords)
    sync = gym.make_vec(
        env_id,
        num_envs=num_envs,
        horizon=horizon,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": "SameStep"},
        **keywords,
    )
    assert isinstance(native, AdversaryVectorEnv)
    assert isinstance(sync, SyncVectorEnv)
    assert data_equivalence(native.reset(seed=5), sync.reset(seed=5), exact=True)
    for mu in proposals(env_id, steps * num_envs).reshape(steps, num_envs, -1):
        assert data_equivalence(native.step(mu), sync.step(mu), exact=True)
    native.close()
    sync.close()


def test_a_pickled_environment_goes_on_alike(env: AdversaryEnv, env_id: str) -> None:
    first, second = proposals(env_id, 2)
    fresh = pickle.loads(pickle.dumps(env))
    for each in (env, fresh):
        each.reset(seed=1)
    twin = pickle.loads(pickle.dumps(env))  # its seed is given, and the generator stands behind it
    outcome = env.step(first)
    assert data_equivalence(outcome, fresh.step(first), exact=True)
    assert data_equivalence(outcome, twin.step(first), exact=True)
    for each in (env, twin):
        each.reset()
    assert data_equivalence(env.step(second), twin.step(second), exact=True)
    fresh.close()
    twin.close()


def test_closing_twice_is_fine(env_id: str) -> None:
    keywords = with_quick_agent(env_id)
    for env in (gym.make(env_id, **keywords), gym.make_vec(env_id, num_envs=2, **keywords)):
        env.reset(seed=0)
        env.close()
        env.close()


def test_the_spec_survives_json(env_id: str) -> None:
    spec = gym.spec(env_id)
    assert EnvSpec.from_json(spec.to_json()) == spec
    assert spec.max_episode_steps is None
    env = gym.make(env_id)
    again = gym.make(EnvSpec.from_json(env.unwrapped.spec.to_json()))
    assert again.unwrapped.spec == env.unwrapped.spec
    env.close()
    again.close()


def test_scores_are_pure(env_id: str) -> None:
    application = sada_gym.make_application(env_id)
    case, seed = purity_case(env_id), brief_seed(env_id)
    assert_pure(application, n=case.n, seed=seed, sizes=case.sizes, other_process=False)
    application.close()


def evaluated(worlds: list[tuple[Application, np.ndarray, list[int]]]) -> list[Outcomes]:
    return [application.evaluate(mu, seeds) for application, mu, seeds in worlds]


def test_another_process_gives_the_same_outcomes() -> None:
    """One process evaluates on a track of each family: its start takes longest.

    Two worlds each are enough: `test_scores_are_pure` varies batches, tiles and their order.
    """
    worlds = []
    for env_id in filter(lambda env_id: not MISSING[env_id], SHIPPED):
        application = sada_gym.make_application(env_id)
        worlds.append((application, *draw_worlds(application, 2, brief_seed(env_id))))
    elsewhere = in_fresh_process(evaluated, worlds, home=ApplicationCard)
    for (application, _, _), here, child in zip(worlds, evaluated(worlds), elsewhere, strict=True):
        compare_outcomes(here, child, f"of {application.name} in another process")
        application.close()


@pytest.mark.slow
@pytest.mark.parametrize("env_id", [env_id for env_id in SHIPPED if not MISSING[env_id]])
def test_scores_are_pure_in_every_batch_size(env_id: str) -> None:
    application = sada_gym.make_application(env_id)
    assert_pure(application, n=17 if one_step_is_slow(env_id) else 70)
    application.close()


def test_infos_can_be_batched(env_id: str) -> None:
    application = sada_gym.make_application(env_id, **with_shipped_agent_on_one_track(env_id))
    check_outcomes(application, n=4 if one_step_is_slow(env_id) else 32)
    application.close()


def test_no_parameter_is_dead(env_id: str) -> None:
    application = sada_gym.make_application(env_id)
    check_live_parameters(application, seed=seed_of(env_id, case_of(CARD_OF[env_id].name).telling))
    application.close()


@pytest.mark.parametrize("card", cards(), ids=lambda card: card.name)
def test_the_docstring_has_gymnasiums_headings(card: ApplicationCard) -> None:
    headings = [
        "Description",
        "Action Space",
        "Observation Space",
        "Rewards",
        "Starting State",
        "Episode End",
        "Arguments",
        "Version History",
    ]
    lines = [
        line.strip()[3:]
        for line in (load(card.application).__doc__ or "").splitlines()
        if "## " in line
    ]
    assert lines == headings


@pytest.mark.parametrize(
    ("general", "track"), [pair for pair in SAME_WORLDS.items() if not MISSING[pair[0]]]
)
def test_a_general_id_is_its_default_track(general: str, track: str) -> None:
    ids = (general, track)
    specs = [gym.spec(env_id) for env_id in ids]
    assert specs[0].entry_point == specs[1].entry_point
    assert specs[0].vector_entry_point == specs[1].vector_entry_point
    envs = [gym.make(env_id).unwrapped for env_id in ids]
    first, other = (env.application for env in envs)
    assert type(first) is type(other)
    for what in ("name", "version", "settings", "fingerprint", "fooling_threshold", "sample_size"):
        assert getattr(first, what) == getattr(other, what), what
    assert repr(first.parameters) == repr(other.parameters)
    (mu,) = proposals(track, 1)
    for env in envs:
        env.reset(seed=11)
    assert data_equivalence(envs[0].step(mu), envs[1].step(mu), exact=True)
    for env_id in ids:
        vector = gym.make_vec(env_id, num_envs=2)
        assert isinstance(vector, AdversaryVectorEnv)
        assert vector.application.settings == first.settings
        assert vector.application.fingerprint == first.fingerprint
        vector.close()
    for env in envs:
        env.close()


def test_every_id_is_a_world_or_the_same_as_one() -> None:
    assert {*WORLDS, *SAME_WORLDS} == set(IDS)
    assert set(SAME_WORLDS.values()) <= set(WORLDS)
    for card in INSTALLED:  # what differs from every track is tested itself
        settings = [sada_gym.make_application(i).settings for i in (card.id, *card.track_ids)]
        assert (settings[0] in settings[1:]) == (card.same_as is not None)


def test_the_general_id_with_its_keyword_is_the_track() -> None:
    assert sada_gym.tracks() == tuple(i for card in cards() for i in card.track_ids)
    application = sada_gym.make_application("SADA-Detection-DiningTable-v0")
    assert application.settings["object_class"] == "diningtable"
    assert len([i for i in sada_gym.tracks() if i.startswith("SADA-Detection-")]) == 12


def test_registering_again_changes_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        register_environments()


def test_importing_the_package_loads_nothing_heavy() -> None:
    program = (
        "import sys, sada_gym\n"
        "heavy = {'torch', 'pybullet', 'highway_env', 'pymunk', 'scipy', 'sklearn', 'matplotlib',"
        " 'trimesh', 'stable_baselines3', 'pydantic', 'typer', 'numba', 'pytest'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_a_child_process_can_name_the_module() -> None:
    program = (
        "import gymnasium as gym\n"
        "env = gym.make('sada_gym:SADA-Analytic-v0', dimension=3)\n"
        "print(env.action_space.shape)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "(3,)", done.stderr


class OwnEnv(AdversaryEnv):
    """An environment that a user registers."""

    def __init__(self, *, dimension: int = 2, **kwargs: Any) -> None:
        from sada_gym.envs.analytic import AnalyticApplication

        super().__init__(AnalyticApplication(dimension=dimension), **kwargs)


@pytest.fixture
def own_id() -> Iterator[str]:
    gym.register("Own-v3", entry_point=OwnEnv)
    yield "Own-v3"
    del gym.registry["Own-v3"]


def test_make_application_takes_a_users_own_id(own_id: str) -> None:
    assert len(sada_gym.make_application(own_id, dimension=5).parameters) == 5


def test_make_application_imports_the_module_before_the_colon() -> None:
    application = sada_gym.make_application("sada_gym:SADA-Analytic-v0", dimension=3)
    assert len(application.parameters) == 3


def test_make_application_gives_what_the_environment_has() -> None:
    mu = [[0.2, 0.3]]
    application = sada_gym.make_application("SADA-Analytic-v0", regions=3)
    env = gym.make("SADA-Analytic-v0", regions=3)
    assert_array_equal(
        application.evaluate(mu, [0]).score, env.unwrapped.application.evaluate(mu, [0]).score
    )


@pytest.mark.parametrize(
    ("env_id", "keywords", "message"),
    [
        (
            "SADA-Analitic-v0",
            {},
            r"Expected a registered environment id, got 'SADA-Analitic-v0'. Did you mean "
            r"'SADA-Analytic-v0'.* `sada-gym envs` lists",
        ),
        ("SADA-Analytic", {}, r"got 'SADA-Analytic'. Did you mean 'SADA-Analytic-v0'"),
        ("SADA-Analytic-v9", {}, r"got 'SADA-Analytic-v9'. Did you mean 'SADA-Analytic-v0'"),
        ("no_such_module:X-v0", {}, "Expected an importable module before the colon"),
        ("CartPole-v1", {}, "Expected an adversary environment behind 'CartPole-v1', got CartPole"),
        (
            "SADA-Analytic-v0",
            {"dimensoin": 3},
            "Expected the keyword of SADA-Analytic-v0 to be one of dimension, .*; got "
            "'dimensoin'. Did you mean dimension",
        ),
        ("SADA-Analytic-v0", {"dimension": 0}, "Expected dimension to be an int of at least 1"),
    ],
)
def test_unknown_ids_and_keywords_are_refused(
    env_id: str, keywords: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        sada_gym.make_application(env_id, **keywords)


def test_an_id_with_only_a_vector_entry_point_is_refused() -> None:
    gym.register("VectorOnly-v0", vector_entry_point="sada_gym.envs:AdversaryVectorEnv")
    try:
        assert find_spec("VectorOnly-v0").entry_point is None
        with pytest.raises(ValueError, match="Expected 'VectorOnly-v0' to have an entry point"):
            sada_gym.make_application("VectorOnly-v0")
    finally:
        del gym.registry["VectorOnly-v0"]


@pytest.mark.parametrize("card", cards(), ids=lambda card: card.name)
def test_a_card_names_its_application(card: ApplicationCard) -> None:
    kind = load(card.application)
    assert (kind.name, kind.version) == (card.name, card.version)
    assert card.id == f"{card.name}-v{card.version}"


def test_every_folder_of_an_application_has_its_card_in_the_list() -> None:
    folder = Path(envs.__file__).parent
    folders = {path.parent.name for path in folder.glob("*/application.py")}
    # whose environments and images are the users' own
    assert folders == {*APPLICATIONS, "wrapped", "images"}
    assert len({card.name for card in cards()}) == len(APPLICATIONS)


def test_every_keyword_of_an_application_works_through_make() -> None:
    for card in INSTALLED:
        accepted = inspect.signature(load(card.application)).parameters
        env = gym.make(card.id, **{name: p.default for name, p in accepted.items()})
        assert env.unwrapped.application.settings == sada_gym.make_application(card.id).settings


def test_an_application_is_registered_by_its_name() -> None:
    kwargs = {"application": "sada_gym.envs.analytic:AnalyticApplication", "dimension": 3}
    entry_points = {
        "entry_point": "sada_gym.envs:AdversaryEnv",
        "vector_entry_point": "sada_gym.envs:AdversaryVectorEnv",
    }
    gym.register("Named-v0", **entry_points, kwargs=kwargs)
    try:
        assert gym.make("Named-v0", regions=2).unwrapped.application.regions == 2
        assert gym.make_vec("Named-v0", num_envs=2).action_space.shape == (2, 3)
    finally:
        del gym.registry["Named-v0"]


@pytest.mark.parametrize(
    ("application", "keywords", "message"),
    [
        ("sada_gym.envs.analytic:AnalyticApplication", {"regoins": 3}, "Did you mean regions"),
        (AnalyticApplication(), {"regions": 3}, "Expected no keywords with a finished application"),
        (dict, {}, "Expected an Application, a subclass of it, or the 'module:Class' of one"),
        ("sada_gym.envs:AdversaryEnv", {}, "Expected an Application, a subclass of it"),
        (AnalyticApplication, {"horizon": 0}, "Expected horizon to be an int of at least 1"),
    ],
)
@pytest.mark.parametrize("kind", [AdversaryEnv, AdversaryVectorEnv])
def test_what_is_no_application_is_refused(
    kind: Any, application: Any, keywords: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        kind(application, **keywords)


@pytest.mark.parametrize("render_mode", [5, b"rgb_array", ["rgb_array"], "rgb_aray"])
@pytest.mark.parametrize("make", [gym.make, gym.make_vec, sada_gym.make_application])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_bad_render_mode_gets_a_sentence(make: Any, render_mode: Any) -> None:
    with pytest.raises(ValueError, match=r"Expected render_mode None or among .*rgb_array"):
        make("SADA-Analytic-v0", render_mode=render_mode)


@pytest.mark.long
def test_racing_without_pybullet_says_what_to_install():
    code = (
        "import sys; sys.modules['pybullet'] = None; import gymnasium as gym, sada_gym; "
        "gym.make('SADA-Digits-3-v0').close(); gym.make('SADA-UAV-v0')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "MissingExtra: Expected PyBullet for racing" in done.stderr
    assert "pip install -c constraints.txt '.[racing]'" in done.stderr
