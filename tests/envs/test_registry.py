"""Every registered environment keeps the contract of DESIGN.md."""

from __future__ import annotations

import pickle
import subprocess
import sys
import warnings
from collections.abc import Iterator
from itertools import product
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import SyncVectorEnv
from numpy.testing import assert_array_equal
from stable_baselines3.common.env_checker import check_env as check_env_sb3

import sada_gym
from sada_gym.envs import AdversaryEnv, AdversaryVectorEnv
from sada_gym.registration import TABLE, find_spec, register_environments
from sada_gym.testing.purity import assert_pure
from sada_gym.testing.rules import check_live_parameters, check_outcomes

IDS = sada_gym.env_ids()
GENERAL_IDS = [row.id for row in TABLE if not row.kwargs]
FEW_SIZES = (1, 5, 16, 17, 70)
FEW_WORLDS = {"SADA-Driving": 7, "SADA-UAV": 17}
"""Where an evaluation is many episodes, these fill tiles of agents in as many ways."""


@pytest.fixture(params=IDS)
def env_id(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def env(env_id: str) -> Iterator[AdversaryEnv]:
    env = gym.make(env_id, render_mode="rgb_array")
    yield env.unwrapped  # type: ignore[misc]
    env.close()


def proposals(env_id: str, n: int, seed: int = 0) -> np.ndarray:
    dimension = len(sada_gym.make_application(env_id).parameters)
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (n, dimension)).astype(np.float32)


def test_gymnasium_accepts_it_without_a_warning(env: AdversaryEnv) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)


def test_sb3_accepts_it_without_a_warning(env: AdversaryEnv) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env_sb3(env, skip_render_check=False)


def test_two_instances_agree_exactly(env_id: str) -> None:
    def run() -> list[Any]:
        env = gym.make(env_id, horizon=2)
        steps: list[Any] = [env.reset(seed=3)]
        steps += [env.step(mu) for mu in proposals(env_id, 2)]
        steps += [env.reset(), env.step(proposals(env_id, 1, seed=1)[0])]
        env.close()
        return steps

    assert data_equivalence(run(), run(), exact=True)


def test_reset_and_step_equal_evaluate(env: AdversaryEnv, env_id: str) -> None:
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


def test_replay_gives_frames_and_the_same_score(env: AdversaryEnv, env_id: str) -> None:
    (mu,) = proposals(env_id, 1)
    env.reset(seed=11)
    info = env.step(mu)[4]
    frames, score = env.replay(mu, 11)
    assert score == info["score"]
    assert len(frames) >= 1
    for frame in [*frames, env.render(), env.application.view(mu, 11)]:
        assert isinstance(frame, np.ndarray)
        assert frame.dtype == np.uint8
        assert frame.ndim == 3
        assert frame.shape[2] == 3


def test_pictures_of_a_bad_seed_are_refused(env: AdversaryEnv, env_id: str) -> None:
    (mu,) = proposals(env_id, 1)
    draws = (env.replay, env.application.render, env.application.view)
    for draw, seed in product(draws, [-1, 2**31, 1.5, "x"]):
        with pytest.raises(ValueError, match=r"Expected seeds to be ints in \[0, 2\*\*31\)"):
            draw(mu, seed)


@pytest.mark.parametrize("horizon", [1, 3])
def test_the_native_batch_equals_the_scalar_environments(env_id: str, horizon: int) -> None:
    num_envs = 2 if env_id.startswith(tuple(FEW_WORLDS)) else 3
    native = gym.make_vec(env_id, num_envs=num_envs, horizon=horizon)
    sync = gym.make_vec(
        env_id,
        num_envs=num_envs,
        horizon=horizon,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": "SameStep"},
    )
    assert isinstance(native, AdversaryVectorEnv)
    assert isinstance(sync, SyncVectorEnv)
    assert data_equivalence(native.reset(seed=5), sync.reset(seed=5), exact=True)
    for mu in proposals(env_id, 4 * num_envs).reshape(4, num_envs, -1):
        assert data_equivalence(native.step(mu), sync.step(mu), exact=True)
    native.close()
    sync.close()


def test_a_pickled_environment_goes_on_alike(env: AdversaryEnv, env_id: str) -> None:
    first, second = proposals(env_id, 2)
    fresh = pickle.loads(pickle.dumps(env))
    env.reset(seed=1)
    fresh.reset(seed=1)
    assert data_equivalence(env.step(first), fresh.step(first), exact=True)
    env.reset()
    twin = pickle.loads(pickle.dumps(env))
    assert data_equivalence(env.step(second), twin.step(second), exact=True)
    fresh.close()
    twin.close()


def test_closing_twice_is_fine(env_id: str) -> None:
    for env in (gym.make(env_id), gym.make_vec(env_id, num_envs=2)):
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
    general = env_id in GENERAL_IDS
    if application.name in FEW_WORLDS:
        n = FEW_WORLDS[application.name]
        sizes = None if general else (n // 2, n // 2 + 1)
        assert_pure(application, n=n, sizes=sizes, other_process=general)
    else:
        sizes = None if general else FEW_SIZES
        assert_pure(application, sizes=sizes, other_process=general)
    application.close()


def test_infos_can_be_batched(env_id: str) -> None:
    application = sada_gym.make_application(env_id)
    check_outcomes(application, n=FEW_WORLDS.get(application.name, 32))
    application.close()


def test_no_parameter_is_dead(env_id: str) -> None:
    application = sada_gym.make_application(env_id)
    check_live_parameters(application)
    application.close()


def test_the_docstring_has_gymnasiums_headings(env: AdversaryEnv) -> None:
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
    found = [line.strip()[3:] for line in (type(env).__doc__ or "").splitlines() if "## " in line]
    assert found == headings


def test_the_general_id_with_its_keyword_is_the_track() -> None:
    assert [row.id for row in TABLE if row.kwargs] == list(sada_gym.tracks())
    assert gym.spec("SADA-Detection-DiningTable-v0").kwargs == {"object_class": "diningtable"}
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
            "Expected keywords of SADA-Analytic-v0 among dimension, .*, got 'dimensoin'. "
            "Did you mean 'dimension'",
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


@pytest.mark.parametrize("env_id", sada_gym.env_ids())
def test_the_id_carries_the_applications_name_and_version(env_id):
    application = sada_gym.make_application(env_id)
    assert env_id.startswith(application.name)
    assert env_id.endswith(f"-v{application.version}")
