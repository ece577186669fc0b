import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from toy import Toy, paraboloid

from sada_gym.errors import BudgetExhausted, Notice, StoreError, UserError, WorkerError
from sada_gym.evaluation.evaluator import Evaluator, _chunk_size
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluation.workers import PortableScorer
from sada_gym.oracle import Oracle, evaluation_seeds

MU = np.random.default_rng(0).uniform(-1, 1, (150, 3)).astype(np.float32)


def scores(problem=None, mu=MU, **settings):
    with Oracle(problem or Toy(), budget=len(mu), **settings) as oracle:
        return oracle(mu)


REFERENCE = scores()


def test_scores_are_the_applications_own():
    seeds = evaluation_seeds(0, "train", 0, len(MU))
    np.testing.assert_array_equal(REFERENCE, Toy().evaluate(MU, seeds).score)


def test_budget_counts_down_and_ends_with_nothing_evaluated(tmp_path):
    log = tmp_path / "log"
    oracle = Oracle(Toy(log=str(log)), budget=5)
    assert (oracle.dimension, oracle.threshold, oracle.remaining) == (3, 0.3, 5)
    oracle(MU[:3])
    assert oracle.remaining == 2
    with pytest.raises(BudgetExhausted, match="at most 2 more queries of 5, got 3"):
        oracle(MU[:3])
    assert oracle.remaining == 2
    assert len(log.read_text().splitlines()) == 3
    assert oracle(MU[:0]).shape == (0,)
    oracle(MU[:2])
    assert oracle.remaining == 0


def test_seeds_follow_from_the_index_alone():
    whole = evaluation_seeds(7, "train", 0, 1000)
    assert whole == evaluation_seeds(7, "train", 0, 400) + evaluation_seeds(7, "train", 400, 600)
    assert len(set(whole)) > 995
    assert all(0 <= seed < 2**31 for seed in whole)
    assert np.mean(whole) == pytest.approx(2**30, rel=0.05)
    assert whole != evaluation_seeds(8, "train", 0, 1000)


def test_streams_share_no_seed():
    low_bits = {
        stream: {seed % 4 for seed in evaluation_seeds(0, stream, 0, 50)}
        for stream in ("train", "test", "validation", "verification")
    }
    assert list(low_bits.values()) == [{0}, {1}, {2}, {3}]


def test_one_call_or_many_give_the_same():
    oracle = Oracle(Toy(), budget=150)
    parts = [oracle(MU[:1]), oracle(MU[1:70]), oracle(MU[70:])]
    np.testing.assert_array_equal(np.concatenate(parts), REFERENCE)
    np.testing.assert_array_equal(oracle.record.mu, MU)
    np.testing.assert_array_equal(oracle.record.score, REFERENCE)
    replayed = Toy().evaluate(MU, oracle.record.seed.tolist()).score
    np.testing.assert_array_equal(replayed, REFERENCE)


@pytest.mark.parametrize("chunk_size", [1, 7, 1000])
def test_chunks_do_not_matter(chunk_size):
    np.testing.assert_array_equal(scores(workers=Workers(chunk_size=chunk_size)), REFERENCE)


def test_workers_do_not_matter_and_both_work(tmp_path):
    log = tmp_path / "log"
    result = scores(Toy(log=str(log), pause_s=0.01), workers=2)
    np.testing.assert_array_equal(result, REFERENCE)
    processes = {line.split()[0] for line in log.read_text().splitlines()}
    assert len(processes) == 2
    assert str(os.getpid()) not in processes


def test_an_environment_id_works_in_processes_too():
    with Oracle("toy:Toy-v0", budget=150, workers=2, env_kwargs={"pause_s": 0.0}) as oracle:
        np.testing.assert_array_equal(oracle(MU), REFERENCE)


@pytest.mark.parametrize(
    ("given", "kind", "message"),
    [
        ({"count": 0}, ValueError, "workers of at least 1, got 0"),
        ({"chunk_size": 0}, ValueError, "chunk_size of at least 1, got 0"),
        ({"executor": 5}, TypeError, "Expected an executor of concurrent.futures, .* got 5"),
    ],
)
def test_workers_that_cannot_be_are_refused(given, kind, message):
    with pytest.raises(kind, match=message):
        Workers(**given)


@pytest.mark.parametrize("kind", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_any_executor_does_and_is_left_open(kind):
    with kind(2) as executor:
        result = scores(workers=Workers(2, executor))
        np.testing.assert_array_equal(result, REFERENCE)
        assert executor.submit(abs, -1).result() == 1


def threads_of_blas(mu):
    """Score with the number of threads that this worker may use."""
    return np.full(len(mu), float(os.environ.get("OMP_NUM_THREADS", "0")))


def test_workers_have_one_thread_each_and_the_parent_keeps_its_own(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    before = dict(os.environ)
    result = scores(threads_of_blas, dimension=3, threshold=0.3, workers=2)
    assert set(result) == {1.0}
    assert dict(os.environ) == before


def warning_all_the_time(mu):
    """Warn of much more than the pipe to the parent holds."""
    for number in range(500):
        warnings.warn(f"{number} " * 200, RuntimeWarning, stacklevel=1)
    return np.zeros(len(mu))


def test_workers_that_warn_all_the_time_go_on_and_are_heard():
    workers = Workers(2, chunk_size=150)
    with pytest.warns(RuntimeWarning) as heard:
        result = scores(warning_all_the_time, dimension=3, threshold=0.3, workers=workers)
    assert set(result) == {0.0}
    assert [str(warning.message)[:2] for warning in heard] == [f"{number} " for number in range(10)]


def test_a_function_is_a_problem():
    with Oracle(paraboloid, dimension=2, threshold=0.3, budget=10) as oracle:
        np.testing.assert_allclose(oracle([[0.5, 0.5], [1, 0]]), [0.25, 0.5])
    np.testing.assert_array_equal(
        scores(paraboloid, dimension=3, threshold=0.3, workers=2), paraboloid(MU)
    )


def test_mu_is_rounded_once():
    mu = MU[:1].astype(np.float64) + 1e-12
    oracle = Oracle(Toy(), budget=1)
    assert oracle(mu)[0] == REFERENCE[0]
    assert oracle.record.mu.dtype == np.float32


@pytest.mark.parametrize(
    ("count", "workers"), [(1, 2), (10, 2), (250, 2), (20_000, 2), (20_000, 8)]
)
def test_chunks_keep_all_workers_busy(count, workers):
    size = _chunk_size(count, workers)
    assert 1 <= size <= 64
    assert -(-count // size) >= min(count, 2 * workers)


def test_a_store_answers_what_it_knows(tmp_path):
    store, log = tmp_path / "run.sqlite", tmp_path / "log"
    reports = []
    first = scores(Toy(log=str(log)), MU[:100], store=store)
    np.testing.assert_array_equal(first, REFERENCE[:100])
    with Oracle(
        Toy(log=str(log)), budget=200, store=store, progress=lambda *counts: reports.append(counts)
    ) as oracle:
        np.testing.assert_array_equal(oracle(MU), REFERENCE)
        assert oracle.remaining == 50
    assert reports == [(100, 200, 100), (150, 200, 100)]
    assert len(log.read_text().splitlines()) == 150


def test_progress_comes_after_each_chunk():
    reports = []
    scores(workers=Workers(2, chunk_size=40), progress=lambda *counts: reports.append(counts))
    assert len(reports) == 4
    assert reports[-1] == (150, 150, 0)
    assert [done for done, _, _ in reports] == sorted(done for done, _, _ in reports)


def test_oracles_on_one_evaluator_share_its_store(tmp_path):
    evaluator = Evaluator(Toy(), store=tmp_path / "run.sqlite")
    with Oracle(evaluator, budget=10) as train, Oracle(evaluator, budget=5, stream="test") as test:
        train(MU[:10])
        test(MU[:5])
        assert not set(train.record.seed) & set(test.record.seed)
    assert len(evaluator.store) == 15
    evaluator.close()


def test_an_evaluator_without_its_store_keeps_nothing_more(tmp_path):
    first, second = tmp_path / "first.sqlite", tmp_path / "second.sqlite"
    with_store = Evaluator(Toy(), store=first)
    Oracle(with_store, budget=10)(MU[:10])
    with_store.detach()
    with_store.detach()
    assert with_store.store is None
    Oracle(with_store, budget=10, stream="test")(MU[:10])
    with_store.attach(second)
    Oracle(with_store, budget=5)(MU[:5])
    with_store.attach(first)  # closes the second one
    assert len(with_store.store) == 10
    with EvaluationStore(second) as store:
        assert len(store) == 5
    with_store.close()
    with pytest.raises(StoreError, match="to be open"):  # not silently without it
        Oracle(with_store, budget=5)(MU[:5])


class Interrupting:
    """Stand in for a Ctrl-C after so many chunks."""

    def __init__(self, chunks):
        self.left = chunks

    def __call__(self, done, total, cached):
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt


@pytest.mark.parametrize("workers", [1, 2])
def test_an_interrupt_keeps_what_was_evaluated(tmp_path, workers):
    store, log = tmp_path / "run.sqlite", tmp_path / "log"
    problem = Toy(log=str(log), pause_s=0.002)
    settings = {"store": store, "workers": Workers(workers, chunk_size=10)}
    with pytest.raises(KeyboardInterrupt):
        scores(problem, progress=Interrupting(3), **settings)
    known = []
    result = scores(problem, progress=lambda d, t, k: known.append(k), **settings)
    np.testing.assert_array_equal(result, REFERENCE)
    assert 30 <= known[0] < 150


@pytest.mark.parametrize("workers", [1, 2])
def test_an_applications_error_comes_through_and_the_rest_is_kept(tmp_path, workers):
    store = tmp_path / "run.sqlite"
    mu = MU[np.argsort(MU[:, 0])]
    settings = {"store": store, "workers": Workers(workers, chunk_size=10)}
    with pytest.raises(RuntimeError, match="the world collapsed"):
        scores(Toy(fail_above=0.5), mu, **settings)
    known = []
    scores(Toy(), mu, progress=lambda d, t, k: known.append(k), **settings)
    assert known[0] >= 10


def suicide(mu):
    """Kill the process that scores."""
    os.kill(os.getpid(), 9)


@pytest.mark.long
def test_a_dead_worker_is_told_of():
    with pytest.raises(WorkerError, match="A worker process died: out of memory"):
        scores(suicide, dimension=3, threshold=0.3, workers=2)


class HomeOnly:
    """A function that can be pickled here but loaded in no other process."""

    def __init__(self):
        self.home = os.getpid()

    def __call__(self, mu):
        return paraboloid(mu)

    def __setstate__(self, state):
        if state["home"] != os.getpid():
            raise LookupError("no such thing here")


def test_what_workers_cannot_load_is_told_of():
    with pytest.raises(WorkerError, match="could not load the problem"):
        scores(HomeOnly(), dimension=3, threshold=0.3, workers=2)


def test_what_cannot_be_pickled_is_refused_with_workers_only():
    lock = threading.Lock()

    def local(mu):
        with lock:
            return paraboloid(mu)

    scores(local, dimension=3, threshold=0.3)
    with pytest.raises(TypeError, match=r"can be pickled.*lock.*Leave out open files.*workers=1"):
        scores(local, dimension=3, threshold=0.3, workers=2)


SCRIPT = """
import gymnasium as gym, numpy as np
from sada_gym import GymnasiumApplication
from sada_gym.evaluation.oracle import Oracle

class Step(gym.Env):
    observation_space, action_space = gym.spaces.Box(-1, 1, (1,)), gym.spaces.Discrete(2)
    def __init__(self, x=0.0): self.x = x
    def reset(self, *, seed=None, options=None): return np.zeros(1, np.float32), {}
    def step(self, action): return np.zeros(1, np.float32), self.x, True, False, {}

gym.register("Step-v0", entry_point=Step, max_episode_steps=5)
half = 0.5
application = GymnasiumApplication(
    "Step-v0", agent=lambda seen: 0, parameters={"x": (0.0, 1.0)},
    score=lambda episode: half * episode.total, fooling_threshold=0.2, agent_id="a",
)
with Oracle(application, budget=2, workers=2) as oracle:
    print(oracle(np.array([[-1.0], [1.0]])).tolist())
"""


@pytest.mark.long
def test_a_script_needs_no_main_guard(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("[0.0, 0.5]\n", "")


def test_a_daemonic_process_evaluates_alone(monkeypatch):
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)
    with pytest.warns(Notice, match="A daemonic process may start no workers"):
        assert (scores(paraboloid, dimension=3, threshold=0.3, workers=2) >= 0.0).all()


def test_what_a_worker_lacks_is_told_by_its_own_sentence():
    task = PortableScorer.of(Lost())
    with pytest.raises(UserError, match=r"^Expected an agent there, but nobody"):
        task(MU[:1], [0])


class Lost:
    """Its agent is gone where it is loaded."""

    def __call__(self, mu):
        return paraboloid(mu)

    def __setstate__(self, state):
        raise UserError("Expected an agent there, but nobody is there.")

    def __getstate__(self):
        return {"agent": 1}


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda mu: paraboloid(mu)[:, None], r"shape \(10,\) from the function .* got \(10, 1\)"),
        (lambda mu: paraboloid(mu)[1:], r"shape \(10,\) .* got \(9,\)"),
        (lambda mu: paraboloid(mu) * np.nan, "Expected finite scores from the function, got nan"),
        (lambda mu: np.where(mu[:, 0] > 0, np.inf, 0), "got inf for mu ="),
        (lambda mu: ["0.5"] * len(mu), "from the function to be real numbers, got dtype <U3"),
        (lambda mu: mu[:, 0] + 1j, "from the function to be real numbers, got dtype complex"),
        (lambda mu: None, "from the function to be real numbers, got dtype object: None"),
        (lambda mu: np.ma.masked_less(mu[:, 0], 0), "Expected scores without a mask"),
    ],
)
def test_a_functions_bad_scores_are_refused(function, message):
    with pytest.raises(ValueError, match=message):
        scores(function, MU[:10], dimension=3, threshold=0.3)


@pytest.mark.parametrize(
    ("problem", "settings", "error", "message"),
    [
        (paraboloid, {}, TypeError, "Expected dimension= and threshold= with a function"),
        (paraboloid, {"dimension": 0, "threshold": 0.3}, ValueError, "dimension of at least 1"),
        (Toy(), {"dimension": 3, "threshold": 0.3}, TypeError, "Toy has its own"),
        (Toy(), {"env_kwargs": {"a": 1}}, TypeError, "only with an environment id"),
        (42, {}, TypeError, "an Application or a function .* got 42"),
        (Toy(), {"workers": 0}, ValueError, "workers of at least 1, got 0"),
        (Toy(), {"budget": -1}, ValueError, "Expected budget of at least 0, got -1"),
        (Toy(), {"seed": -1}, ValueError, "Expected seed of at least 0, got -1"),
        (Toy(), {"stream": "exam"}, ValueError, "stream of train, test, .* got 'exam'"),
        ("SADA-Analytic-v9", {}, ValueError, "Did you mean 'SADA-Analytic-v0'"),
        (
            paraboloid,
            {"dimension": "3", "threshold": 0.3},
            TypeError,
            "dimension to be a whole num",
        ),
        (
            paraboloid,
            {"dimension": 3, "threshold": "low"},
            ValueError,
            "a finite number, got 'low'",
        ),
        (paraboloid, {"dimension": 3, "threshold": 1j}, ValueError, "a finite number, got 1j"),
        (Toy(), {"env_kwargs": ["a"]}, TypeError, r"env_kwargs to be a dictionary, got \['a'\]"),
        (Toy(), {"budget": True}, TypeError, "Expected budget to be a whole number, got True"),
        (Toy(), {"workers": "2"}, TypeError, "Expected workers to be a whole number, got '2'"),
        (Toy(), {"store": 5}, TypeError, "Expected the path of an evaluation store, got 5"),
        (Toy(), {"store": b"a"}, TypeError, "Expected the path of an evaluation store, got b'a'"),
        (Toy(), {"progress": 5}, TypeError, "Expected progress to be a function or None, got 5"),
    ],
)
def test_bad_arguments_are_refused(problem, settings, error, message):
    with pytest.raises(error, match=message):
        Oracle(problem, **{"budget": 10, **settings})


@pytest.mark.parametrize(
    ("mu", "message"),
    [
        (MU[0], r"Expected mu of shape \(n, 3\), got \(3,\)"),
        (MU[:, :2], r"got \(150, 2\)"),
        (MU * np.nan, "got nan at row 0"),
        (MU * 3, "within"),
    ],
)
def test_bad_mu_is_refused(mu, message):
    with pytest.raises(ValueError, match=message):
        Oracle(Toy(), budget=500)(mu)


def test_no_store_without_an_identity(tmp_path):
    store = tmp_path / "run.sqlite"
    with pytest.raises(StoreError, match="Expected no store with a bare function"):
        Oracle(paraboloid, dimension=2, threshold=0.3, budget=1, store=store)
    with pytest.raises(StoreError, match="Expected a fingerprint"):
        Oracle(Toy(agent_id=None), budget=1, store=store)
    assert not store.exists()


def test_negative_zero_is_stored_as_zero(tmp_path):
    oracle = Oracle(lambda mu: np.full(len(mu), -0.0), dimension=3, threshold=0.3, budget=1)
    assert not np.signbit(oracle(MU[:1]))[0]


def test_errors_survive_a_process_boundary():
    for error in (WorkerError("a"), BudgetExhausted("b"), StoreError("c")):
        assert str(pickle.loads(pickle.dumps(error))) == str(error)


def ask(oracle):
    return oracle(MU[:1])


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_copy_in_another_process_is_refused(method):
    """As in a SubprocVecEnv: every process would spend the whole budget."""
    oracle = Oracle(Toy(), budget=2)
    with ProcessPoolExecutor(1, multiprocessing.get_context(method)) as pool:
        error = pool.submit(ask, oracle).exception()
    assert isinstance(error, UserError)
    assert "in the process that made the oracle" in str(error)
    assert len(oracle(MU[:2])) == 2


def test_importing_is_light():
    heavy = "('torch', 'scipy', 'matplotlib', 'pybullet')"
    code = f"import sada_gym.attacks, sys; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"
