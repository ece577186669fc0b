import copy
import os
import shutil
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from toy import Toy

from sada_gym.errors import StoreError, StoreInUse
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluation.store_errors import explained

RNG = np.random.default_rng(0)
MU = RNG.uniform(-1, 1, (100, 3)).astype(np.float32)
SEEDS = [int(s) for s in RNG.integers(2**31, size=100)]
SCORES = RNG.random(100)

WITH_CODES = sys.version_info >= (3, 11)
"""Python 3.10 gives SQLite's errors no codes: there the sentence names several causes."""

IN_USE = "another run has it open" if WITH_CODES else "open in another run"
ONLY_USER = rf"only user of the store .* {IN_USE}" if WITH_CODES else IN_USE
NO_STORE = "got something else in" if WITH_CODES else "or something else in"
CORRUPT = "got a corrupt one in" if WITH_CODES else "got a corrupt one"
FULL = "the disk is full" if WITH_CODES else "full disk"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.sqlite"


def test_scores_come_back_to_the_last_bit(path):
    with EvaluationStore(path) as store:
        key = store.context(ApplicationKey.of(Toy()))
        store.commit(key, MU[:60], SEEDS[:60], SCORES[:60])
    with EvaluationStore(path) as store:
        assert len(store) == 60
        key = store.context(ApplicationKey.of(Toy()))
        order = RNG.permutation(100)
        stored = store.lookup(key, MU[order], [SEEDS[i] for i in order])
        np.testing.assert_array_equal(stored, np.where(order < 60, SCORES[order], np.nan))


def test_mu_seed_and_context_all_matter(path):
    with EvaluationStore(path) as store:
        key = store.context(ApplicationKey.of(Toy()))
        store.commit(key, MU[:1], [5], SCORES[:1])
        assert store.lookup(key, MU[:1], [5])[0] == SCORES[0]
        assert np.isnan(store.lookup(key, MU[:1], [6])[0])
        assert np.isnan(store.lookup(key, np.nextafter(MU[:1], np.float32(2)), [5])[0])
        for other in (Toy(offset=0.1), Toy(agent_id="another")):
            assert np.isnan(store.lookup(store.context(ApplicationKey.of(other)), MU[:1], [5])[0])


def test_settings_are_compared_whatever_their_order():
    forwards = with_settings({"a": 1, "b": 2})
    backwards = with_settings({"b": 2, "a": 1})
    assert ApplicationKey.of(forwards) == ApplicationKey.of(backwards)


def with_settings(settings):
    return type("Odd", (Toy,), {"settings": settings})()


def test_another_version_is_refused(path):
    with EvaluationStore(path) as store:
        store.context(ApplicationKey.of(Toy()))
        with pytest.raises(StoreError, match=r"of Toy-v1 .* got some of Toy-v0.*Name a new store"):
            store.context(ApplicationKey.of(Toy(version=1)))


def test_no_fingerprint_is_refused():
    with pytest.raises(StoreError, match=r"Expected a fingerprint of Toy's agent.*agent_id="):
        ApplicationKey.of(Toy(agent_id=None))


def test_settings_that_are_not_json_are_refused():
    with pytest.raises(TypeError, match="Expected JSON-compatible settings from Odd"):
        ApplicationKey.of(with_settings({"shape": object()}))


@pytest.mark.parametrize(
    "content", [b"no database", b"x" * 5000, b"SQLite format 3\x00" + b"x" * 984]
)
def test_a_file_that_is_no_database_is_refused_and_left_alone(path, content):
    path.write_bytes(content)
    with pytest.raises(StoreError, match=rf"{NO_STORE} .*name another file"):
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
        key = store.context(ApplicationKey.of(Toy()))
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
    with pytest.raises(StoreError, match=rf"{CORRUPT} .*left as it is"):
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
        with pytest.raises(StoreError, match=ONLY_USER):
            EvaluationStore(path)
        child = subprocess.run(
            [sys.executable, "-c", OPEN, str(path)], capture_output=True, text=True, check=False
        )
        assert IN_USE in child.stderr
        store.context(ApplicationKey.of(Toy()))
    EvaluationStore(path).close()


OPEN = "import sys; from sada_gym.evaluation.store import EvaluationStore as S; S(sys.argv[1])"

DIE = """
import os, sys, numpy as np
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.evaluation.store import EvaluationStore
store = EvaluationStore(sys.argv[1])
settings = {"dimension": 3, "offset": 0.0}
key = store.context(ApplicationKey(name="Toy", version=0, settings=settings, fingerprint="toy"))
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
        settings = {"dimension": 3, "offset": 0.0}
        key = store.context(
            ApplicationKey(name="Toy", version=0, settings=settings, fingerprint="toy")
        )
        mu = np.array([[0.0] * 3, [0.25] * 3, [0.5] * 3], np.float32)
        assert store.lookup(key, mu, [0, 1, 2]).tolist() == [0.0, 0.125, 0.25]


def test_a_store_takes_little_more_room_than_its_scores(path):
    def taken():
        return sum(file.stat().st_size for file in path.parent.iterdir())

    with EvaluationStore(path) as store:
        key = store.context(ApplicationKey.of(Toy(8)))
        greatest = 0
        for start in range(0, 5_000, 50):
            mu = RNG.uniform(-1, 1, (50, 8)).astype(np.float32)
            seeds = [int(seed) for seed in RNG.integers(2**31, size=50)]
            store.commit(key, mu, seeds, RNG.random(50))
            greatest = max(greatest, taken() - 60 * start)
    assert greatest < 900_000  # the write-ahead log, emptied again and again
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    assert taken() < 60 * 5_000 + 30_000  # 32 bytes of mu, 8 each of seed and score


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


def fill(store, count=1000):
    key = store.context(ApplicationKey.of(Toy()))
    for i in range(count):
        mu = np.full((64, 3), i / count, np.float32)
        store.commit(key, mu, list(range(64)), np.full(64, 0.5))


@pytest.fixture
def small_disk(tmp_path):
    """Mount a file system of 64 KiB, where this user may."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("needs the right to mount a file system")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_disk_is_said_and_keeps_what_was_stored(small_disk):
    path = small_disk / "run.sqlite"
    with EvaluationStore(path) as store:
        with pytest.raises(StoreError, match=FULL):
            fill(store)
        kept = len(store)
        assert kept > 0
        with pytest.raises(StoreError, match="full"):  # and again, not another error
            fill(store)
    with EvaluationStore(path) as store:
        assert len(store) == kept


def test_no_room_for_a_new_store_is_not_called_a_corrupt_one(small_disk):
    with pytest.raises(OSError, match="No space left"):
        (small_disk / "other").write_bytes(b"x" * 100_000)
    with pytest.raises(StoreError, match=FULL):
        EvaluationStore(small_disk / "run.sqlite")


@pytest.mark.parametrize("name", ["old.sqlite", "new.sqlite"])
def test_a_read_only_file_system_is_not_called_a_corrupt_store(small_disk, name):
    EvaluationStore(small_disk / "old.sqlite").close()
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    with pytest.raises(StoreError, match=rf"write to the store .*{name}, but .* is read-only"):
        EvaluationStore(small_disk / name)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
@pytest.mark.parametrize("what", ["file", "folder"])
def test_a_read_only_file_or_folder_is_told_of(path, what):
    EvaluationStore(path).close()
    place = path if what == "file" else path.parent
    place.chmod(0o555)
    with pytest.raises(StoreError, match=rf"{what} is read-only"):
        EvaluationStore(path)
    place.chmod(0o755)


FILE_LIMIT = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
sys.path[:0] = [TESTS + "/support", TESTS + "/evaluation"]
from test_store import EvaluationStore, fill
with EvaluationStore(sys.argv[1]) as store:
    fill(store)
"""


@pytest.mark.skipif(os.name != "posix", reason="needs resource limits")
def test_a_disk_that_reports_an_error_is_told_of(path):
    code = FILE_LIMIT.replace("TESTS", repr(str(Path(__file__).parents[1])))
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True)
    last = done.stderr.strip().splitlines()[-1]
    assert "StoreError: Expected to" in last
    if WITH_CODES:
        assert "reported an error (SQLITE_IOERR" in last
    with EvaluationStore(path) as store:
        assert len(store) > 0


def test_a_page_that_goes_bad_during_a_run_is_told_of(path):
    filled(path)
    with EvaluationStore(path) as store:
        key = store.context(ApplicationKey.of(Toy()))
        store._connection.execute("PRAGMA shrink_memory")  # so that pages are read again
        content = path.read_bytes()
        with path.open("r+b") as file:
            file.seek(4096)
            file.write(b"\xff" * (len(content) - 4096))
        for call in (lambda: store.lookup(key, MU, SEEDS), lambda: len(store)):
            with pytest.raises(StoreError, match="got a corrupt one"):
                call()


def test_a_closed_store_is_told_of(path):
    store = EvaluationStore(path)
    key = store.context(ApplicationKey.of(Toy()))
    store.close()
    store.close()
    calls = (
        lambda: store.context(ApplicationKey.of(Toy())),
        lambda: store.lookup(key, MU, SEEDS),
        lambda: store.commit(key, MU, SEEDS, SCORES),
        lambda: len(store),
    )
    for call in calls:
        with pytest.raises(StoreError, match="to be open, and used in the thread that opened it"):
            call()


def test_another_threads_store_is_told_of(path):
    with EvaluationStore(path) as store, ThreadPoolExecutor(1) as thread:
        future = thread.submit(len, store)
        with pytest.raises(StoreError, match="used in the thread that opened it"):
            future.result()


def rewrite(path, *statements):
    with sqlite3.connect(path) as connection:
        for statement in statements:
            connection.execute(statement)
    connection.close()


@pytest.mark.parametrize("score", ["1.5", "-0.1", "9e999", "'half'", "x'00'"])
def test_a_score_that_no_run_wrote_is_refused(path, score):
    filled(path)
    rewrite(path, f"UPDATE evaluation SET score = {score} WHERE seed = {SEEDS[3]}")
    content = path.read_bytes()
    with pytest.raises(StoreError, match=r"corrupt one .*score that is not a number from 0 to 1"):
        EvaluationStore(path)
    assert path.read_bytes() == content


@pytest.mark.parametrize("mu", ["x'0000'", "x'00000000'", "'text'", "zeroblob(16)"])
def test_a_mu_of_another_length_is_refused(path, mu):
    filled(path)
    rewrite(path, f"UPDATE evaluation SET mu = {mu} WHERE seed = {SEEDS[3]}")
    with pytest.raises(StoreError, match=r"got a corrupt one .* or a bad mu"):
        EvaluationStore(path)


@pytest.mark.parametrize(
    ("statement", "lacking"),
    [
        ("DROP TABLE evaluation", "evaluation.context"),
        ("DROP TABLE context", "context.fingerprint"),
        ("ALTER TABLE evaluation RENAME COLUMN score TO q", "evaluation.score"),
    ],
)
def test_a_missing_table_or_column_is_named(path, statement, lacking):
    filled(path)
    rewrite(path, "PRAGMA foreign_keys = OFF", statement)
    with pytest.raises(StoreError, match=rf"corrupt one .*it lacks .*{lacking}"):
        EvaluationStore(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs FIFOs")
def test_a_fifo_is_refused_without_waiting_for_its_other_end(path):
    os.mkfifo(path)
    with pytest.raises(StoreError, match=r"regular file .*, got a pipe"):
        EvaluationStore(path)


def test_a_loop_of_links_is_refused(tmp_path):
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    for path in (loop, loop / "run.sqlite"):
        with pytest.raises(StoreError, match=r"Expected a path .*loop.*symbolic links"):
            EvaluationStore(path)


@pytest.mark.parametrize("name", ["a" * 300, "a\0b"])
def test_a_name_that_no_file_can_have_is_refused(tmp_path, name):
    with pytest.raises(StoreError, match="Expected a path for the evaluation store, got"):
        EvaluationStore(tmp_path / name)


def test_a_folder_that_is_a_file_is_refused(path):
    path.touch()
    with pytest.raises(StoreError, match="Expected a folder for the store"):
        EvaluationStore(path / "run.sqlite")


def test_memory_is_a_file_like_any_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    EvaluationStore(":memory:").close()
    assert (tmp_path / ":memory:").is_file()


@pytest.mark.skipif(not WITH_CODES, reason="needs the codes of SQLite's errors")
def test_being_in_use_has_a_type_of_its_own(path):
    with EvaluationStore(path), pytest.raises(StoreInUse):
        EvaluationStore(path)


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (sqlite3.OperationalError("anything"), r"could not \(anything\).*another run, on a full"),
        (sqlite3.DatabaseError("anything"), r"a corrupt one or something else in .* \(anything\)"),
        (sqlite3.IntegrityError("anything"), r"SQLite refused \(anything\)"),
    ],
)
def test_without_a_code_the_sentence_is_still_true(path, error, message):
    with pytest.raises(StoreError, match=message), explained(path):
        raise error


def test_a_store_that_was_forgotten_can_be_opened_again(path):
    EvaluationStore(path)
    with EvaluationStore(path) as store:
        assert len(store) == 0


def test_a_store_cannot_be_copied(path):
    with (
        EvaluationStore(path) as store,
        pytest.raises(TypeError, match=r"to stay where it was opened, got a copy or a pickle"),
    ):
        copy.deepcopy(store)


FORKS = """
import os, shutil, sys
import numpy as np
from sada_gym.errors import StoreError
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.evaluation.store import EvaluationStore

def put(seed):
    store.commit(key, np.zeros((64, 3), np.float32), range(seed, seed + 64), np.zeros(64))

path, copy, ending = sys.argv[1:]
store = EvaluationStore(path)
key = store.context(ApplicationKey(name="a", version=0, settings={}, fingerprint=""))
put(0)
child = os.fork()
if not child:
    if ending == "used":
        try:
            put(1_000)
        except StoreError as error:
            os._exit("in a forked one" in str(error))
    elif ending == "forgotten":
        del store
        sys.exit(1)  # frees everything
    store.close()
    os._exit(1)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1
put(100)
if not os.fork():  # a copy of the folder now is what a kill would leave
    shutil.copytree(os.path.dirname(path), copy)
    os._exit(0)
os.wait()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("ending", ["closed", "forgotten", "used"])
def test_a_forked_copy_leaves_the_parents_commits_alone(tmp_path, ending):
    (tmp_path / "run").mkdir()
    left = tmp_path / "left"
    command = [sys.executable, "-c", FORKS, str(tmp_path / "run" / "a.sqlite"), str(left), ending]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with EvaluationStore(left / "a.sqlite") as store:
        assert len(store) == 128
