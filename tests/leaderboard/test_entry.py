import json

import numpy as np
import pytest
from sada_gym.submission.entry import (
    EntryResult,
    ResultFiles,
    read_about,
    read_entries,
    read_entry,
    write_about,
    write_result,
    write_verified,
)
from sada_gym.submission.models import (
    FORMAT,
    About,
    Identity,
    Result,
    SeedResult,
    Verified,
    entry_name,
    result_stem,
)

from sada_gym.errors import FileError, UserError
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.measure import measure


def about(**changes):
    told = {
        "format": FORMAT,
        "name": "mine",
        "title": "mine (paper)",
        "authors": ['Ada "L." ö 😀'],
        "licence": "MIT",
        "adversary": "gp",
        "options": '{"induced_size": null, "a": "b\\\\"}',
    }
    return About(**(told | changes))


def identity(**changes):
    told = {
        "track": "SADA-Analytic-v0",
        "agent": "boxes",
        "rule": "paper-budgets",
        "budget": 1_000,
        "samples": 20,
        "application": "SADA-Analytic",
        "version": 0,
        "application_settings": {"kind": "boxes"},
        "fingerprint": "0" * 64,
        "fooling_threshold": 0.5,
        "reference": None,
        "adversary": "gp",
        "preset": None,
        "options": {},
        "resolved": {"restarts": 3},
    }
    return Identity(**(told | changes))


def evaluations(seed, n=20):
    rng = np.random.default_rng(seed)
    mu = rng.uniform(-1, 1, (n, 2)).astype(np.float32)
    return Evaluations(mu, rng.uniform(size=n), rng.integers(0, 2**31, n))


def claim(seed, samples):
    measures = measure(samples, samples, 0.5, fooling_set=None, ideal=None, images=None, seed=seed)
    return SeedResult(seed=seed, queries=1_000, measures=measures)


@pytest.fixture
def folder(tmp_path):
    there = tmp_path / "mine"
    there.mkdir()
    write_about(there, about())
    samples = {seed: evaluations(seed) for seed in (1, 0)}
    failed = SeedResult(seed=7, queries=0, error="too small", measures=None)
    claims = [failed, *(claim(seed, one) for seed, one in samples.items())]
    write_result(there, Result.make(identity(), claims), samples)
    return there


def test_what_is_written_is_read(folder):
    entry = read_entry(folder)
    assert entry.about == about()
    assert json.loads(entry.about.options) == {"induced_size": None, "a": "b\\"}
    assert list(entry.results) == ["SADA-Analytic-v0.boxes.paper-budgets"]
    (result,) = entry.results.values()
    assert [one.seed for one in result.claimed.seeds] == [0, 1, 7]
    assert list(result.samples) == [0, 1]
    assert result.tier == "claimed"
    np.testing.assert_array_equal(result.samples[1].mu, evaluations(1).mu)
    np.testing.assert_array_equal(result.samples[1].seed, evaluations(1).seed)
    assert [one.about.name for one in read_entries(folder.parent)] == ["mine"]


def verified(result: EntryResult):
    return Verified.make(result.claimed, result.samples, "1")


def test_what_was_verified_counts_for_these_samples_alone(folder):
    ((stem, result),) = read_entry(folder).results.items()
    write_verified(folder, stem, verified(result))
    assert read_entry(folder).results[stem].tier == "verified"
    found = verified(result).model_copy(update={"samples_sha256": "0" * 64})
    write_verified(folder, stem, found)
    assert read_entry(folder).results[stem].tier == "claimed"
    write_result(folder, result.claimed, result.samples)
    assert not ResultFiles(folder, stem).verified.exists()


def test_a_seed_that_only_one_file_has_is_left_out(folder):
    files = ResultFiles(folder, result_stem("SADA-Analytic-v0", "boxes", "paper-budgets"))
    claimed, samples = files.read()
    before = files.claims.read_bytes()
    write_result(folder, claimed, samples | {9: evaluations(9)})
    files.claims.write_bytes(before)  # as if killed between the two files
    result, kept = files.read()
    assert list(kept) == [0, 1]
    assert result == claimed
    write_result(folder, claimed, {0: samples[0]})
    assert [one.seed for one in files.read()[0].seeds] == [0, 7]


def test_a_failure_alone_is_a_result(folder):
    failed = SeedResult(seed=7, queries=0, error="too small", measures=None)
    write_result(folder, Result.make(identity(), [failed]), {})
    (result,) = read_entry(folder).results.values()
    assert result.samples == {}
    assert result.claimed.seeds == (failed,)


def test_the_identity_is_all_that_decides_the_result():
    changes = [{"agent": "discs"}, {"resolved": {"restarts": 4}}, {"fooling_threshold": 0.6}]
    assert len({identity(**one).sha256 for one in [{}, *changes]}) == 4
    assert identity().sha256 == identity().sha256


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"restarts": 3', '"restarts": 4', "Make the entry anew instead of editing it"),
        ('"format": 1', '"format": 2', "Expected format 1 in .*, got 2"),
        ('"seed": 7', '"seed": 1', "Expected ascending seeds in .*, each once, got .0, 1, 1."),
        ('"format": 1', '"formats": 1', "Expected .* as sada-gym writes it"),
    ],
)
def test_an_edited_result_gets_a_sentence(folder, old, new, said):
    (path,) = folder.glob("*.json")
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(FileError, match=said):
        read_entry(folder)


def test_another_name_than_the_contents_gets_a_sentence(folder):
    (path,) = folder.glob("*.json")
    path.rename(folder / "other.json")
    (folder / "SADA-Analytic-v0.boxes.paper-budgets.npz").rename(folder / "other.npz")
    with pytest.raises(FileError, match="Expected the file of this result to be called"):
        read_entry(folder)
    folder.rename(folder.parent / "yours")
    with pytest.raises(UserError, match="Expected the folder of the entry mine to have its name"):
        read_about(folder.parent / "yours")


@pytest.mark.parametrize("name", ["../up", "a/b", "A", "", ".hidden", "a" * 65, "con.", "x.tmp"])
def test_names_are_plain(name):
    with pytest.raises(ValueError, match="expected a name of at most 64"):
        about(name=name)


def test_names_come_from_labels():
    assert entry_name("bbgan-boost (paper)") == "bbgan-boost-paper"
    assert entry_name("bench_toys:Picky") == "bench_toys-picky"
