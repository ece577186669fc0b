import io
import zipfile

import numpy as np
import pytest

from sada_gym.errors import FileError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.differences import check_same_record, differences
from sada_gym.run.folder import read_samples, write_samples


def test_samples_are_read_as_written(tmp_path):
    mu = np.arange(6, dtype=np.float32).reshape(3, 2)
    samples = Evaluations(mu, np.array([0.1, 0.2, 0.3]), np.array([7, 8, 9]))
    write_samples(tmp_path / "samples.npz", samples)
    restored = read_samples(tmp_path / "samples.npz")
    for name in ("mu", "score", "seed"):
        np.testing.assert_array_equal(getattr(restored, name), getattr(samples, name))


def npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def odd_zip():
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in ("mu", "score", "seed"):
            archive.writestr(f"{name}.npy", "no array")
    return buffer.getvalue()


MU, SCORE, SEED = np.zeros((2, 3), np.float32), np.zeros(2), np.zeros(2, np.int64)


@pytest.mark.parametrize(
    "content",
    [
        b"no zip",
        b"",
        odd_zip(),
        npz(mu=MU, score=SCORE),
        npz(mu=np.array([object()]), score=SCORE, seed=SEED),
        npz(mu=MU[0], score=SCORE, seed=SEED),
        npz(mu=MU, score=SCORE[:1], seed=SEED),
        npz(mu=MU.astype(float), score=SCORE, seed=SEED),
    ],
)
def test_other_files_are_refused_in_a_sentence(tmp_path, content):
    path = tmp_path / "samples.npz"
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"samples\.npz") as raised:
        read_samples(path)
    assert "pickle" not in str(raised.value)


def test_a_missing_file_is_a_sentence(tmp_path):
    with pytest.raises(FileError, match=r"samples\.npz"):
        read_samples(tmp_path / "samples.npz")


def test_differences_go_down_to_single_entries():
    old = {"a": {"b": 1, "c": 2}, "d": (1,), "e": None}
    assert differences(old, old) == []
    check_same_record("nothing else", old, old)
    new = {"a": {"b": 1, "c": 3}, "d": (1,), "f": 4}
    assert differences(old, new) == ["a.c was 2 and is 3", "f was None and is 4"]
    with pytest.raises(ValueError, match=r"Expected this, got others: a.c was .* is 4. Fix it."):
        check_same_record("this", old, new, "Fix it.")
