import json
from dataclasses import replace

import numpy as np
import pytest

from sada_gym.board.results.entry import (
    EntryResult,
    GroupFiles,
    read_entries,
    read_entry,
    read_metadata,
    write_metadata,
    write_results,
)
from sada_gym.board.results.models import EntryMetadata, Result, SeedResult, Verified, entry_name
from sada_gym.board.results.samples import read_samples, samples_bytes
from sada_gym.errors import FileError, UserError
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.evaluations import Evaluations, evaluation_seeds
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.measure import measure
from sada_gym.experiment.record import Experiment, Protocol
from sada_gym.experiment.target import Target

PLACE = "SADA-Analytic-v0.boxes.paper-budgets"
OTHER_PLACE = "SADA-Analytic-v0.boxes.equal-queries"


def make_metadata(**changes):
    fields = {
        "name": "mine",
        "title": "mine (paper)",
        "authors": ['Ada "L." ö 😀'],
        "licence": "MIT",
        "command": 'run --set a="b\\\\"',
    }
    return EntryMetadata(**(fields | changes))


def make_experiment(
    agent="boxes", threshold=0.5, resolved=None, rule="paper-budgets", name="SADA-Analytic"
):
    return Experiment(
        target=Target(
            track="SADA-Analytic-v0",
            agent=agent,
            application=ApplicationKey(
                name=name, version=0, settings={"kind": "boxes"}, fingerprint="0" * 64
            ),
            fooling_threshold=threshold,
            reference=None,
        ),
        adversary=AdversarySpec(name="gp", resolved=resolved or {"restarts": 3}),
        protocol=Protocol(rule=rule, budget=1_000, samples=20),
    )


def make_samples(seed, n=20):
    rng = np.random.default_rng(seed)
    mu = rng.uniform(-1, 1, (n, 2)).astype(np.float32)
    return Evaluations(mu, rng.uniform(size=n), np.array(evaluation_seeds(seed, "test", 0, n)))


def make_claims(seed):
    samples = make_samples(seed)
    measures = measure(samples, samples, 0.5, fooling_set=None, ideal=None, images=None, seed=seed)
    return SeedResult(seed=seed, queries=1_000, measures=measures)


FAILED = SeedResult(seed=7, queries=0, error="too small", measures=None)


def make_result(*seeds, **changes):
    claims = [FAILED, *map(make_claims, seeds)]
    samples = {seed: make_samples(seed) for seed in seeds}
    return EntryResult(Result.make(make_experiment(**changes), claims), samples)


@pytest.fixture
def folder(tmp_path):
    entry = tmp_path / "mine"
    entry.mkdir()
    write_metadata(entry, make_metadata())
    write_results(entry, [make_result(1, 0)])
    return entry


@pytest.fixture
def files(folder):
    return GroupFiles(folder, "SADA-Analytic")


def test_what_is_written_is_read(folder):
    entry = read_entry(folder)
    assert entry.metadata == make_metadata()
    assert entry.adversary == make_experiment().adversary
    assert list(entry.results) == [PLACE]
    (result,) = entry.results.values()
    assert result.experiment == make_experiment()
    assert [claims.seed for claims in result.claimed.seeds] == [0, 1, 7]
    assert list(result.samples) == [0, 1]
    assert result.tier == "claimed"
    for seed in (0, 1):
        for array in ("mu", "score", "seed"):
            expected = getattr(make_samples(seed), array)
            np.testing.assert_array_equal(getattr(result.samples[seed], array), expected)
    assert [entry.metadata.name for entry in read_entries(folder.parent)] == ["mine"]


def test_the_results_on_the_tracks_of_an_application_share_their_files(folder):
    write_results(folder, [make_result(0, rule="equal-queries"), make_result(0, name="Other app")])
    assert sorted(path.name for path in folder.iterdir()) == [
        *("Other-app.json", "Other-app.npz", "SADA-Analytic.json", "SADA-Analytic.npz"),
        "entry.toml",
    ]
    assert list(GroupFiles(folder, "SADA-Analytic").read()) == [OTHER_PLACE, PLACE]


def make_verified(result):
    return Verified.make(result.claimed, result.samples, ("mine", result.claimed.sha256), "1")


def test_what_was_verified_counts_for_these_samples_alone(folder, files):
    (result,) = read_entry(folder).results.values()
    files.add_verified(PLACE, make_verified(result))
    assert read_entry(folder).results[PLACE].tier == "verified"
    write_results(folder, [make_result(0, rule="equal-queries")])  # beside it
    assert read_entry(folder).results[PLACE].tier == "verified"
    assert read_entry(folder).results[OTHER_PLACE].tier == "claimed"
    for change in ({"samples_sha256": "0" * 64}, {"sha256": "0" * 64}):
        files.add_verified(PLACE, make_verified(result).model_copy(update=change))
        assert read_entry(folder).results[PLACE].tier == "claimed"
    write_results(folder, [result])
    assert not files.verified.exists()


def test_another_seed_is_not_verified(folder, files):
    (result,) = read_entry(folder).results.values()
    files.add_verified(PLACE, make_verified(result))
    result = read_entry(folder).results[PLACE].with_seed(make_claims(2), make_samples(2))
    assert [claims.seed for claims in result.claimed.seeds] == [0, 1, 2, 7]
    write_results(folder, [result])
    assert list(read_entry(folder).results[PLACE].samples) == [0, 1, 2]
    assert not files.verified.exists()


def test_a_seed_that_only_one_file_has_is_left_out(folder, files):
    before = files.claims.read_bytes()
    write_results(folder, [make_result(0, 1, 9)])
    write_results(folder, [make_result(0, rule="equal-queries")])
    files.claims.write_bytes(before)  # as if killed between the two files
    assert list(files.read()) == [PLACE]
    result = files.read()[PLACE]
    assert list(result.samples) == [0, 1]
    assert result.claimed == make_result(0, 1).claimed
    files.samples.write_bytes(samples_bytes({PLACE: {0: make_samples(0)}}))
    assert [claims.seed for claims in files.read()[PLACE].claimed.seeds] == [0, 7]
    files.samples.write_bytes(samples_bytes({}))
    assert [claims.seed for claims in files.read()[PLACE].claimed.seeds] == [7]


def test_a_failure_alone_is_a_result(folder):
    write_results(folder, [make_result()])
    (result,) = read_entry(folder).results.values()
    assert result.samples == {}
    assert result.claimed.seeds == (FAILED,)


def test_the_experiment_is_all_that_decides_the_result():
    changes = [{"agent": "discs"}, {"resolved": {"restarts": 4}}, {"threshold": 0.6}]
    assert len({make_experiment(**change).sha256 for change in [{}, *changes]}) == 4
    assert make_experiment().sha256 == make_experiment().sha256
    assert Result.make(make_experiment().at(3), ()) == Result.make(make_experiment(), ())


def test_samples_of_other_evaluation_seeds_are_not_written(files):
    before = files.samples.read_bytes()
    samples = make_samples(0)
    wrong = {0: replace(samples, seed=samples.seed + 4)}
    with pytest.raises(UserError, match="Expected the evaluation seeds of the test stream of seed"):
        files.write([replace(make_result(0), samples=wrong)])
    assert files.samples.read_bytes() == before


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"restarts": 3', '"restarts": 4', "Make the entry again instead of editing it"),
        ('"format": 2', '"format": 3', "Expected format 2 in .*, got 3"),
        ('"seed": 7', '"seed": 1', "Expected ascending seeds of .*, each once, got .0, 1, 1."),
        ('"format": 2', '"formats": 2', "Expected .* as sada-gym writes it"),
        ('"seed": null', '"seed": 3', "expected no seed of the experiment"),
    ],
)
def test_an_edited_result_gets_a_sentence(folder, files, old, new, said):
    text = files.claims.read_text()
    assert old in text
    files.claims.write_text(text.replace(old, new))
    with pytest.raises(FileError, match=said):
        read_entry(folder)


def test_an_unsorted_result_gets_a_sentence(folder, files):
    write_results(folder, [make_result(0, rule="equal-queries")])
    content = json.loads(files.claims.read_text())
    first, second = content["results"]
    for results in ([second, first], [first, first]):
        files.claims.write_text(json.dumps({**content, "results": results}))
        with pytest.raises(FileError, match=r"Expected ascending results in .*, each once, got"):
            read_entry(folder)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("seeds", np.array([0, 0]), "Expected ascending seeds of PLACE"),
        ("seeds", np.array([1, 0]), "Expected ascending seeds of PLACE"),
        ("seeds", np.array([-1, 0]), "Expected seeds of PLACE in .* from 0 up, got -1"),
        ("seeds", np.zeros(0, int), "0 seeds, 40 mu and 40 scores"),
        ("seeds", np.array([0, 1, 2]), "3 seeds, 40 mu and 40 scores"),
        ("mu", np.zeros((0, 2), np.float32), "2 seeds, 0 mu and 40 scores"),
        ("score", np.zeros(39), "2 seeds, 40 mu and 39 scores"),
        ("mu", np.zeros(40, np.float32), "PLACE.mu of dtype float32 and shape"),
        ("more", np.zeros(1), r"arrays named PLACE.more, PLACE.mu"),
    ],
)
def test_samples_that_do_not_fit_get_a_sentence(files, name, value, said):
    for place in (PLACE, "a\x1b[2J", ""):
        with np.load(files.samples) as archive:
            arrays = {key.replace(PLACE, place): archive[key] for key in archive.files}
        path = files.folder / "samples.npz"
        np.savez(path, **{**arrays, f"{place}.{name}": value})
        with pytest.raises(FileError) as caught:
            read_samples(path)
        assert str(caught.value).isprintable()
        if place == PLACE:
            caught.match(said.replace("PLACE", PLACE))


def test_another_name_than_the_contents_gets_a_sentence(folder, files):
    files.claims.rename(folder / "other.json")
    files.samples.rename(folder / "other.npz")
    with pytest.raises(FileError, match="Expected the results on SADA-Analytic in a file called"):
        read_entry(folder)
    folder.rename(folder.parent / "yours")
    with pytest.raises(UserError, match="Expected the folder of the entry mine to have its name"):
        read_metadata(folder.parent / "yours")


@pytest.mark.parametrize("text", ["format = 1", "format = 'a\\tb'", f"format = 0x{'f' * 5_000}"])
def test_metadata_of_another_format_gets_a_sentence(folder, text):
    path = folder / "entry.toml"
    path.write_text(path.read_text().replace("format = 2", text))
    with pytest.raises(FileError, match=r"Expected format 2 in .*entry.toml, got ") as caught:
        read_metadata(folder)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("name", ["../up", "a/b", "A", "", ".hidden", "a" * 65, "con.", "x.tmp"])
def test_names_are_plain(name):
    with pytest.raises(ValueError, match="expected a name of at most 64"):
        make_metadata(name=name)


def test_results_have_short_names():
    with pytest.raises(UserError, match="but expected the agent in one line of at most 200"):
        Result.make(make_experiment(agent="x" * 201), ())


def test_names_come_from_labels():
    assert entry_name("bbgan-boost (paper)") == "bbgan-boost-paper"
    assert entry_name("bench_toys:Picky") == "bench_toys-picky"
