import sqlite3
import subprocess
import sys

import numpy as np
import pytest
from toy import Toy

from sada_gym.errors import StoreError
from sada_gym.evaluation.store import Context, EvaluationStore

RNG = np.random.default_rng(0)
MU = RNG.uniform(-1, 1, (100, 3)).astype(np.float32)
SEEDS = [int(s) for s in RNG.integers(2**31, size=100)]
SCORES = RNG.random(100)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.sqlite"


def test_scores_come_back_to_the_last_bit(path):
    with EvaluationStore(path) as store:
        key = store.context(Context.of(Toy()))
        store.commit(key, MU[:60], SEEDS[:60], SCORES[:60])
    with EvaluationStore(path) as store:
        assert len(store) == 60
        key = store.context(Context.of(Toy()))
        order = RNG.permutation(100)
        found = store.lookup(key, MU[order], [SEEDS[i] for i in order])
        np.testing.assert_array_equal(found, np.where(order < 60, SCORES[order], np.nan))


def test_mu_seed_and_context_all_matter(path):
    with EvaluationStore(path) as store:
        key = store.context(Context.of(Toy()))
        store.commit(key, MU[:1], [5], SCORES[:1])
        assert store.lookup(key, MU[:1], [5])[0] == SCORES[0]
        assert np.isnan(store.lookup(key, MU[:1], [6])[0])
        assert np.isnan(store.lookup(key, np.nextafter(MU[:1], np.float32(2)), [5])[0])
        for other in (Toy(offset=0.1), Toy(agent_id="another")):
            assert np.isnan(store.lookup(store.context(Context.of(other)), MU[:1], [5])[0])


def test_settings_are_compared_whatever_their_order():
    forwards = with_settings({"a": 1, "b": 2})
    backwards = with_settings({"b": 2, "a": 1})
    assert Context.of(forwards) == Context.of(backwards)


def with_settings(settings):
    return type("Odd", (Toy,), {"settings": settings})()


def test_another_version_is_refused(path):
    with EvaluationStore(path) as store:
        store.context(Context.of(Toy()))
        with pytest.raises(StoreError, match=r"of Toy-v1 .* got some of Toy-v0.*Name a new store"):
            store.context(Context.of(Toy(version=1)))


def test_no_fingerprint_is_refused():
    with pytest.raises(StoreError, match=r"Expected a fingerprint of Toy's agent.*agent_id="):
        Context.of(Toy(agent_id=None))


def test_settings_that_are_not_json_are_refused():
    with pytest.raises(TypeError, match="Expected JSON-compatible settings from Odd"):
        Context.of(with_settings({"shape": object()}))


@pytest.mark.parametrize(
    "content", [b"no database", b"x" * 5000, b"SQLite format 3\x00" + b"x" * 984]
)
def test_a_file_that_is_no_database_is_refused_and_left_alone(path, content):
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"got something else in .*name another file"):
        EvaluationStore(path)
    assert path.read_bytes() == content
    assert [p.name for p in path.parent.iterdir()] == ["run.sqlite"]


def test_another_programs_database_is_refused_and_left_alone(path):
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE evaluation (a)")
    other.close()
    before = path.read_bytes()
    with pytest.raises(StoreError, match="got another program's SQLite file"):
        EvaluationStore(path)
    assert path.read_bytes() == before


def filled(path):
    with EvaluationStore(path) as store:
        key = store.context(Context.of(Toy()))
        for start in range(0, 100, 10):
            rows = slice(start, start + 10)
            store.commit(key, MU[rows], SEEDS[rows], SCORES[rows])


@pytest.mark.parametrize("damage", ["overwritten", "truncated"])
def test_a_corrupt_store_is_refused_and_left_alone(path, damage):
    filled(path)
    content = path.read_bytes()
    if damage == "overwritten":
        content = content[:4096] + b"\xff" * 4096 + content[8192:]
    else:
        content = content[: len(content) - 4096]
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"got a corrupt one in .*left as it is"):
        EvaluationStore(path)
    assert path.read_bytes() == content


def test_another_schema_is_refused(path):
    filled(path)
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version = 99")
    connection.close()
    with pytest.raises(StoreError, match="Expected an evaluation store of schema 1, got schema 99"):
        EvaluationStore(path)


def test_a_second_writer_is_kept_out(path):
    with EvaluationStore(path) as store:
        with pytest.raises(StoreError, match=r"only user of the store .* another run has it open"):
            EvaluationStore(path)
        there = subprocess.run(
            [sys.executable, "-c", OPEN, str(path)], capture_output=True, text=True, check=False
        )
        assert "another run has it open" in there.stderr
        store.context(Context.of(Toy()))
    EvaluationStore(path).close()


OPEN = "import sys; from sada_gym.evaluation.store import EvaluationStore as S; S(sys.argv[1])"

DIE = """
import os, sys, numpy as np
from sada_gym.evaluation.store import Context, EvaluationStore
store = EvaluationStore(sys.argv[1])
key = store.context(Context("Toy", 0, '{"dimension":3,"offset":0.0}', "toy"))
for i in range(3):
    store.commit(key, np.full((1, 3), i / 4, np.float32), [i], np.array([i / 8]))
store._connection.execute("BEGIN IMMEDIATE")
store._connection.execute("INSERT INTO evaluation VALUES (1, 9, x'00', 0.5)")
os.kill(os.getpid(), 9)
"""


def test_commits_survive_a_kill_and_the_lock_does_not(path):
    subprocess.run([sys.executable, "-c", DIE, str(path)], check=False)
    with EvaluationStore(path) as store:
        assert len(store) == 3
        key = store.context(Context.of(Toy()))
        mu = np.array([[0.0] * 3, [0.25] * 3, [0.5] * 3], np.float32)
        assert store.lookup(key, mu, [0, 1, 2]).tolist() == [0.0, 0.125, 0.25]


def test_an_empty_file_becomes_a_store(path):
    path.touch()
    filled(path)
    with EvaluationStore(path) as store:
        assert len(store) == 100


def test_a_missing_folder_or_a_folder_for_a_file_is_refused(tmp_path):
    with pytest.raises(StoreError, match="Expected a folder for the store"):
        EvaluationStore(tmp_path / "nowhere" / "run.sqlite")
    with pytest.raises(StoreError, match="got the folder"):
        EvaluationStore(tmp_path)
