import io
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from sada_gym.errors import FileError
from sada_gym.foundations import files
from sada_gym.foundations.files import (
    Strict,
    read_arrays,
    read_model,
    restore_folder,
    write_file,
    write_folder,
    write_model,
)
from sada_gym.run.folder import read_samples

NEEDS_POSIX = pytest.mark.skipif(os.name != "posix", reason="needs links and pipes")


class Point(Strict):
    x: float
    notes: dict[str, list] = {}  # noqa: RUF012


def test_a_model_comes_back(tmp_path):
    write_model(tmp_path / "point.json", Point(x=0.1))
    assert read_model(tmp_path / "point.json", Point) == Point(x=0.1)
    assert [path.name for path in tmp_path.iterdir()] == ["point.json"]


@NEEDS_POSIX
def test_a_planted_link_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / ".result.json.tmp").symlink_to(victim)
    write_file(tmp_path / "result.json", b"new")
    assert victim.read_text() == "precious"
    assert (tmp_path / "result.json").read_bytes() == b"new"
    assert not (tmp_path / "result.json").is_symlink()


@NEEDS_POSIX
def test_a_planted_link_is_not_followed_by_a_folder_either(tmp_path):
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "kept").touch()
    (tmp_path / ".adversary.tmp").symlink_to(victim)
    write_folder(tmp_path / "adversary", lambda folder: (folder / "new").touch())
    assert [path.name for path in victim.iterdir()] == ["kept"]
    assert [path.name for path in (tmp_path / "adversary").iterdir()] == ["new"]
    assert not (tmp_path / "adversary").is_symlink()


def test_what_a_killed_run_left_is_replaced(tmp_path):
    (tmp_path / ".a.tmp").write_text("half")
    write_file(tmp_path / "a", b"whole")
    (tmp_path / ".b.tmp").mkdir()
    (tmp_path / ".b.tmp" / "half").touch()
    write_folder(tmp_path / "b", lambda folder: (folder / "whole").touch())
    assert [path.name for path in (tmp_path / "b").iterdir()] == ["whole"]
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}


def test_a_folder_is_never_lost(tmp_path, monkeypatch):
    folder = tmp_path / "b"
    write_folder(folder, lambda beside: (beside / "old").touch())
    real, moves = Path.rename, []

    def rename(path, target):
        moves.append(path.name)
        if len(moves) == 2:
            raise KeyboardInterrupt  # as if killed between the two moves
        return real(path, target)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(KeyboardInterrupt):
        write_folder(folder, lambda beside: (beside / "new").touch())
    assert moves == ["b", ".b.tmp"]
    assert not folder.exists()
    restore_folder(folder)
    assert [path.name for path in folder.iterdir()] == ["old"]
    restore_folder(folder)  # with nothing to do
    write_folder(folder, lambda beside: (beside / "new").touch())
    assert [path.name for path in folder.iterdir()] == ["new"]
    assert [path.name for path in tmp_path.iterdir()] == ["b"]


@NEEDS_POSIX
def test_others_may_read_what_the_users_umask_lets_them(tmp_path):
    before = os.umask(0o022)
    try:
        write_file(tmp_path / "a", b"")
    finally:
        os.umask(before)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o644


def a_folder(path):
    path.mkdir()


def a_loop(path):
    path.symlink_to(path)


def a_pipe(path):
    os.mkfifo(path)


def nothing(path):
    pass


@NEEDS_POSIX
@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (nothing, "there is no such file"),
        (a_folder, r"it is a folder\. Name a file"),
        (a_loop, "its path is a loop of links"),
        (a_pipe, "got a pipe, socket or device"),
    ],
)
@pytest.mark.parametrize("read", [lambda path: read_model(path, Point), read_samples])
def test_what_cannot_be_read_is_a_sentence(tmp_path, make, reason, read):
    path = tmp_path / "file"
    make(path)
    with pytest.raises(FileError, match=reason) as caught:
        read(path)
    assert "Errno" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("missing/file", "there is no such file or folder"),
        ("file/file", "a part of its path is a file"),
        ("folder", "it is a folder"),
        ("a" * 300, "its name is too long"),
    ],
)
def test_what_cannot_be_written_is_a_sentence(tmp_path, name, reason):
    (tmp_path / "file").touch()
    (tmp_path / "folder" / "kept").mkdir(parents=True)
    with pytest.raises(FileError, match=rf"Expected to write .*{reason}"):
        write_file(tmp_path / name, b"content")
    assert {path.name for path in tmp_path.iterdir()} == {"file", "folder"}


def test_a_folder_that_cannot_be_written_is_a_sentence(tmp_path):
    with pytest.raises(FileError, match=r"write the folder .* there is no such file or folder"):
        write_folder(tmp_path / "missing" / "adversary", lambda folder: None)


def test_a_mistake_in_filling_a_folder_keeps_its_traceback(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_folder(tmp_path / "adversary", lambda folder: (tmp_path / "typo").read_bytes())


FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from sada_gym.foundations.files import write_file, write_folder
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
for write in (
    lambda path: write_file(path, b"x" * 5000),
    lambda path: write_folder(path, lambda folder: (folder / "a").write_bytes(b"x" * 5000)),
):
    try:
        write(Path(sys.argv[1]) / "result")
    except ValueError as error:
        print(error)
"""


@NEEDS_POSIX
def test_too_little_room_is_a_sentence_and_keeps_what_was_there(tmp_path):
    (tmp_path / "result").write_text("old")
    output = subprocess.check_output([sys.executable, "-c", FULL_DISK, str(tmp_path)], text=True)
    assert output.count("it would be larger than the system allows") == 2
    assert (tmp_path / "result").read_text() == "old"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b'{"x": 1.0, "y": 2}', "y: Extra inputs are not permitted"),
        (b'{"x": ', "Invalid JSON"),
        (b"", "Invalid JSON"),
        ('{"x": 1, "notes": {"ü": []}}'.encode("latin-1"), "byte 20 is not UTF-8"),
        (b'{"x": ' + b"[" * 100_000, "Invalid JSON: recursion limit exceeded"),
        (b'{"x": ' + b"9" * 100_000 + b"}", "Invalid JSON: number out of range"),
    ],
    ids=["field", "cut", "empty", "latin-1", "deep", "digits"],
)
def test_json_that_is_none_of_ours_is_a_sentence(tmp_path, content, reason):
    path = tmp_path / "point.json"
    path.write_bytes(content)
    with pytest.raises(FileError, match=reason):
        read_model(path, Point)


def test_a_huge_file_is_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "MAX_JSON_BYTES", 2**20)
    path = tmp_path / "point.json"
    with path.open("wb") as file:
        file.truncate(3 * 2**20)
    with pytest.raises(FileError, match=r"point.json to be at most 1 MiB, got 3 MiB"):
        read_model(path, Point)


GOOD = {
    "mu": np.zeros((3, 2), np.float32),
    "score": np.zeros(3),
    "seed": np.arange(3, dtype=np.int64),
}


def npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def with_header(shape):
    """Let an array claim a shape that its bytes do not have."""
    array = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        array, {"descr": "<f4", "fortran_order": False, "shape": shape}
    )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("mu.npy", array.getvalue())
        for name in ("score", "seed"):
            stream = io.BytesIO()
            np.save(stream, GOOD[name])
            archive.writestr(f"{name}.npy", stream.getvalue())
    return buffer.getvalue()


def test_samples_come_back(tmp_path):
    path = tmp_path / "samples.npz"
    path.write_bytes(npz(**GOOD))
    samples = read_samples(path)
    for name, array in GOOD.items():
        np.testing.assert_array_equal(getattr(samples, name), array)
        assert getattr(samples, name).dtype == array.dtype


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"no zip", "it is damaged"),
        (npz(**GOOD)[:-40], "it is damaged"),
        (npz(mu=GOOD["mu"]), "arrays named mu"),
        (npz(**GOOD, extra=np.zeros(1)), "arrays named extra, mu, score, seed"),
        (npz(**{**GOOD, "mu": np.zeros((3, 2))}), r"mu of dtype float64 and shape \(3, 2\)"),
        (npz(**{**GOOD, "mu": np.zeros(3, np.float32)}), r"mu of dtype float32 and shape \(3,\)"),
        (npz(**{**GOOD, "score": np.array([print] * 3)}), "score of dtype object"),
        (npz(**{**GOOD, "score": np.zeros(4)}), "as many mu as scores and seeds"),
        (with_header((10**12, 2)), "mu of shape"),
        (with_header((-1, 2)), "mu of shape"),
    ],
)
def test_samples_that_are_none_are_a_sentence(tmp_path, content, reason):
    path = tmp_path / "samples.npz"
    path.write_bytes(content)
    with pytest.raises(FileError, match=reason) as caught:
        read_samples(path)
    assert "pickle" not in str(caught.value)
    assert "Restore the file" in str(caught.value)


def test_damage_anywhere_in_samples_is_a_sentence_or_harmless(tmp_path):
    path = tmp_path / "samples.npz"
    content = npz(**GOOD)
    for at in range(0, len(content), 7):
        path.write_bytes(content[:at] + bytes([content[at] ^ 0xFF]) + content[at + 1 :])
        try:
            read_samples(path)
        except FileError:
            continue


def test_arrays_can_be_changed(tmp_path):
    path = Path(tmp_path / "a.npz")
    path.write_bytes(npz(a=np.zeros((2, 2))))
    read_arrays(path, {"a": ("f8", 2)})["a"][0, 0] = 1.0


def test_a_name_with_a_nul_is_refused():
    for use in (lambda path: files.write_file(path, b""), lambda path: files.read_file(path, 10)):
        with pytest.raises(FileError, match=r"Expected to .* 'a.x00b', but its name holds a NUL"):
            use(Path("a\0b"))
