import itertools
import json
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_entries import ANALYTIC, make_entry, only_result, replace_result, with_changes
from toy import Greedy, Toy

from sada_gym import attack
from sada_gym.board.results.entry import EntryResult, GroupFiles, write_metadata, write_results
from sada_gym.board.results.models import Result, SeedResult, Verified
from sada_gym.board.results.samples import samples_sha256
from sada_gym.board.submission.checks import check_entry
from sada_gym.board.submission.current import current_experiment
from sada_gym.board.submission.submit import make_metadata, submit, submit_samples
from sada_gym.cli import app
from sada_gym.errors import UserError
from sada_gym.experiment.record import RunReport
from sada_gym.foundations import files as files_module
from sada_gym.foundations.files import read_model
from sada_gym.run.folder import read_samples, write_samples

ROOT = Path(__file__).parents[2]


def made_by(name="mine", **changes):
    fields = {"name": name, "authors": ["Ada L."], "licence": "CC-BY-4.0"}
    return make_metadata(**(fields | changes))


ME = made_by()
UNIFORM = {"track": ANALYTIC, "adversary": "uniform", "queries": 10}


def made_run(folder, **changes):
    fields = {"environment": ANALYTIC, "adversary": "gaussian", "budget": 100, "pictures": False}
    attack(**(fields | changes), out=folder)
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    return [made_run(folder / f"{seed}", seed=seed) for seed in range(2)]


PLACE, OTHER_PLACE = f"{ANALYTIC}.paper-budgets", f"{ANALYTIC}.equal-queries"


def snapshot(folder):
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_runs_become_an_entry(runs, tmp_path):
    entry = submit(runs, ME, out=tmp_path)
    assert entry.folder == tmp_path / "mine"
    result = entry.results[PLACE]
    assert [claims.seed for claims in result.claimed.seeds] == [0, 1]
    assert result.experiment.protocol.budget == 1_000
    assert [claims.queries for claims in result.claimed.seeds] == [100, 100]
    assert result.claimed.seeds[0].search.queries == 100
    assert entry.metadata.title == "mine"
    assert entry.metadata.command == (
        "sada-gym attack SADA-Analytic-v0 --adversary gaussian --budget 100 --seed 0"
    )
    check_entry(entry.folder)


def test_results_join_an_entry_and_replace_only_when_told(runs, tmp_path):
    submit(runs, ME, out=tmp_path)
    entry = submit(runs[:1], ME, rule="equal-queries", out=tmp_path)
    assert list(entry.results) == [OTHER_PLACE, PLACE]
    before = snapshot(tmp_path)
    with pytest.raises(UserError, match=r"Expected a new result, got .* Replace it by --replace"):
        submit(runs[:1], ME, out=tmp_path)
    assert snapshot(tmp_path) == before
    entry = submit(runs[:1], ME, out=tmp_path, replace=True)
    assert len(entry.results[PLACE].claimed.seeds) == 1


def test_what_was_verified_of_other_results_stays(runs, tmp_path):
    entry = submit(runs, ME, out=tmp_path)
    result = entry.results[PLACE]
    salt = "mine", result.claimed.sha256
    verified = Verified.make(result.claimed, result.samples, salt, "1")
    files = GroupFiles(entry.folder, result.experiment.group)
    files.add_verified(PLACE, verified)
    entry = submit(runs[:1], ME, rule="equal-queries", out=tmp_path)
    assert {place: result.tier for place, result in entry.results.items()} == {
        PLACE: "verified",
        OTHER_PLACE: "claimed",
    }
    assert entry.results[PLACE].verified == verified
    entry = submit(runs[:1], ME, out=tmp_path, replace=True)
    assert entry.results[PLACE].tier == "claimed"
    assert not files.verified.exists()


def test_an_outdated_result_stays_beside_new_ones(runs, tmp_path):
    entry = submit(runs, ME, out=tmp_path)
    result = entry.results[PLACE]
    experiment = with_changes(result.experiment, application={"fingerprint": "0" * 64})
    outdated = replace(result, claimed=Result.make(experiment, result.claimed.seeds))
    replace_result(entry.folder, outdated)
    entry = submit(runs[:1], ME, rule="equal-queries", out=tmp_path)
    assert entry.results[PLACE].claimed == outdated.claimed
    with pytest.raises(UserError, match="Expected a new result"):
        submit(runs, ME, out=tmp_path)
    assert submit(runs, ME, out=tmp_path, replace=True).results[PLACE].claimed == result.claimed


def test_what_joins_an_entry_keeps_its_limits(runs, tmp_path, monkeypatch):
    submit(runs, ME, out=tmp_path)
    before = snapshot(tmp_path)
    size = sum(map(len, before.values()))
    monkeypatch.setattr("sada_gym.board.submission.files.MAX_ENTRY_BYTES", size + 1_000)
    with pytest.raises(UserError, match=r"Expected at most 0 MiB in .*mine, got 0 MiB"):
        submit(runs[:1], ME, rule="equal-queries", out=tmp_path)
    assert snapshot(tmp_path) == before


def test_the_pieces_of_two_clones_make_the_same_entry(runs, tmp_path):
    whole = submit(runs, ME, out=tmp_path / "whole")
    one_clone = make_piece(tmp_path / "one", runs[0])
    pieces = submit([one_clone, runs[1]], ME, out=tmp_path / "pieces")
    assert snapshot(pieces.folder) == snapshot(whole.folder)
    other_clone = make_piece(tmp_path / "other", runs[1])
    pieces = submit([other_clone, one_clone], ME, out=tmp_path / "again")
    assert snapshot(pieces.folder) == snapshot(whole.folder)


def make_piece(out, run):
    """Write an entry of one run alone, as a benchmark does in a clone of its own."""
    report = read_model(run / "result.json", RunReport)
    experiment = report.settings.experiment
    current = current_experiment(ANALYTIC, "", "paper-budgets", experiment.adversary)
    claims = SeedResult.of(report)
    folder = out / "piece"
    folder.mkdir(parents=True)
    write_metadata(
        folder,
        make_metadata(
            name="piece",
            title="piece",
            authors=(),
            licence="",
            command="sada-gym attack SADA-Analytic-v0 --adversary gaussian --budget 100 --seed 0",
        ),
    )
    samples = {claims.seed: read_samples(run / "samples.npz")}
    write_results(folder, [EntryResult(Result.make(current, [claims]), samples)])
    return folder


@pytest.mark.parametrize("by", ["writes", "moves"])
def test_killed_at_any_moment_it_ends_with_the_same_bytes(runs, tmp_path, monkeypatch, by):
    def do(out):
        return submit(runs, ME, out=out, replace=True)

    start = submit(runs[:1], ME, rule="equal-queries", out=tmp_path / "start").folder.parent
    submit(runs[:1], ME, out=start)
    files = GroupFiles(start / "mine", "SADA-Analytic")
    result = files.read()[OTHER_PLACE]
    salt = "mine", result.claimed.sha256
    files.add_verified(OTHER_PLACE, Verified.make(result.claimed, result.samples, salt, "1"))
    whole = Path(shutil.copytree(start, tmp_path / "whole"))
    do(whole)
    assert (whole / "mine" / "SADA-Analytic.verified.json").exists()
    module, name = {"writes": (files_module, "write_file"), "moves": (Path, "rename")}[by]
    real, kills = getattr(module, name), 0
    for moment in range(100):
        out = Path(shutil.copytree(start, tmp_path / f"{moment}"))
        calls = itertools.count()

        def killing(*args, calls=calls, moment=moment):
            if next(calls) == moment:
                raise KeyboardInterrupt
            return real(*args)

        with monkeypatch.context() as patch:
            patch.setattr(module, name, killing)
            if module is files_module:
                patch.setattr("sada_gym.board.results.entry.write_file", killing)
            try:
                do(out)
            except KeyboardInterrupt:
                kills += 1
            else:
                break
        if (out / "mine").exists():  # never half of it
            assert snapshot(out / "mine") in (snapshot(start / "mine"), snapshot(whole / "mine"))
        do(out)
        assert snapshot(out) == snapshot(whole)
    assert kills == {"writes": 11, "moves": 2}[by]


def test_an_entry_is_labelled_anew(tmp_path):
    made = make_entry(tmp_path / "benchmark", "ours")
    entry = submit([made], ME, out=tmp_path)
    assert (entry.metadata.name, entry.adversary.name) == ("mine", "my-method")
    (mine,) = entry.results.values()
    assert mine.claimed == only_result(made).claimed
    with pytest.raises(UserError, match="Expected results by the rule equal-queries in"):
        submit([made], ME, rule="equal-queries", out=tmp_path)


def test_samples_become_an_entry_as_the_same_run_does(runs, tmp_path):
    drawn = [np.load(run / "samples.npz")["mu"] for run in runs]
    np.save(tmp_path / "mu1.npy", drawn[1].astype(np.float64))
    fields = UNIFORM | {"adversary": "optuna-tpe", "options": {"trials": 10}}
    entry = submit_samples([drawn[0], tmp_path / "mu1.npy"], ME, **fields, out=tmp_path / "entries")
    ours = submit(runs, made_by("run"), out=tmp_path / "entries")
    mine, theirs = entry.results[PLACE], ours.results[PLACE]
    assert samples_sha256(mine.samples) == samples_sha256(theirs.samples)
    for claims, others in zip(mine.claimed.seeds, theirs.claimed.seeds, strict=True):
        assert claims.queries == 10
        assert claims.search is None
        assert claims.measures == others.measures.model_copy(update={"novelty": None})
    assert entry.adversary.options == {"trials": 10}


def test_ideal_samples_are_evaluated_where_there_is_a_reference_set(tmp_path):
    fields = {"track": "SADA-Digits-3-v0", "adversary": "uniform", "queries": 0}
    mu = np.random.default_rng(0).uniform(-1, 1, (250, 6))
    entry = submit_samples([mu], ME, **fields, out=tmp_path)
    run = made_run(tmp_path / "run", environment="SADA-Digits-v0", env_kwargs={"digit": 3})
    (seed,) = entry.results["SADA-Digits-3-v0.cnn.paper-budgets"].claimed.seeds
    assert 0.5 < seed.measures.relative_coverage < 1
    # a general id with the track's keywords is the track
    same = submit([run], made_by("same"), out=tmp_path)
    assert list(same.results) == ["SADA-Digits-3-v0.cnn.paper-budgets"]


MU = np.zeros((250, 2))


@pytest.mark.parametrize(
    ("samples", "changes", "said"),
    [
        ([MU[:, :1]], {}, r"shape \(250, 2\), the M samples of d parameters .* got \(250, 1\)"),
        ([MU[:9]], {}, r"shape \(250, 2\), .* got \(9, 2\). Draw exactly M = 250 samples"),
        ([MU + 2], {}, r"Expected mu within \[-1, 1\], got 2.0 at row 0, column 0"),
        ([MU * np.nan], {}, r"Expected mu within \[-1, 1\], got nan"),
        ([MU.astype(str)], {}, "Expected mu to be an array of real numbers"),
        ([MU.astype(complex)], {}, "Expected mu to be an array of real numbers"),
        ([], {}, "Expected the samples of 1 to 100 seeds, got 0 arrays"),
        ([MU] * 101, {}, "Expected the samples of 1 to 100 seeds, got 101 arrays"),
        ("mu.npy", {}, "Expected a list of samples, got 'mu.npy'"),
        ([MU], {"queries": 1_001}, r"at most 1,000 queries, got 1,001. uniform may spend 1,000 by"),
        ([MU], {"queries": -1}, "Expected queries of at least 0"),
        ([MU], {"track": "SADA-Digits-v0"}, r"Expected the track to be one of .*SADA-Digits-0-v0"),
        ([MU], {"agent": "cnn"}, "Expected no agent's name on SADA-Analytic-v0"),
        ([MU], {"rule": "none"}, "Expected the rule to be one of paper-budgets, equal-queries"),
        ([MU], {"adversary": ""}, f"Expected a text as adversary for {PLACE} in .*Analytic.json"),
        ([MU], {"adversary": 3}, "Expected an adversary's name, got 3"),
        (
            [MU],
            {"adversary": "x" * 201},
            "expected the adversary in one line of at most 200 characters",
        ),
        ([MU], {"options": [1]}, r"Expected options by name, .*, got \[1\]"),
        ([MU], {"options": {1: 2}}, "Expected options by name, .*, got {1: 2}"),
        ([MU], {"track": ["a"]}, r"Expected the track to be a text, got \['a'\]"),
        ([MU], {"agent": ["a"]}, r"Expected the agent to be a text, got \['a'\]"),
        ([MU], {"rule": None}, "Expected the rule to be a text, got None"),
        ([MU], {"queries": "1"}, "Expected queries to be a whole number, got '1'"),
        (MU[0], {}, r"shape \(250, 2\)"),
        (None, {}, "Expected a list of samples, got None"),
        ([MU], {"options": {"a": object()}}, "Expected options that can be written as JSON"),
        ([MU], {"options": {"a": 2**70}}, "a whole number beyond 64 bits"),
        ([MU], {"adversary": "gp", "options": {"b": 1}}, "Expected the option of gp to be one of"),
        (["missing.npy"], {}, "there is no such file"),
    ],
)
def test_samples_that_do_not_fit_get_a_sentence(tmp_path, samples, changes, said):
    with pytest.raises(UserError, match=said):
        submit_samples(samples, ME, **(UNIFORM | changes), out=tmp_path / "entries")
    assert not (tmp_path / "entries").exists()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"name": "../up"}, "expected a name of at most 64 small letters"),
        ({"name": "con"}, "Expected an entry's folder to be named by"),
        ({"authors": []}, "Expected a text as authors"),
        ({"authors": ["a\nb"]}, "expected text in one line"),
        ({"authors": "Ada"}, "Expected a list of authors, got 'Ada'"),
        ({"licence": ""}, "Expected a text as licence"),
        ({"licence": "all rights"}, "Expected a licence's SPDX name"),
        ({"paper": "javascript:alert(1)"}, "Expected the address of a page as paper"),
        ({"repository": "x.org"}, "Expected the address of a page as repository"),
        ({"title": "x" * 201}, "title: .* at most 200"),
        ({"rank": 1}, "rank: Extra inputs are not permitted"),
        ({"name": None}, "name: Input should be a valid string"),
        ({"format": 1}, "format: Input should be greater than or equal to 2"),
    ],
)
def test_metadata_that_does_not_fit_gets_a_sentence(runs, tmp_path, changes, said):
    with pytest.raises(UserError, match=said) as caught:
        submit(runs, made_by(**changes), out=tmp_path / "entries")
    # nothing of the temporary folder in which an entry is made
    assert str(Path(tempfile.gettempdir(), tempfile.gettempprefix())) not in str(caught.value)
    assert not (tmp_path / "entries").exists()


def spoilt_runs(folder, runs):
    """Runs that cannot take part, by what the sentence says."""
    stopped = folder / "stopped"
    stopped.mkdir()
    (stopped / "attack.json").write_bytes((runs[0] / "attack.json").read_bytes())
    (folder / "empty").mkdir()
    edited = folder / "edited"
    edited.mkdir()
    for path in runs[0].glob("*.npz"):
        (edited / path.name).write_bytes(path.read_bytes())
    report = json.loads((runs[0] / "result.json").read_text())
    (edited / "result.json").write_text(json.dumps({**report, "afr": 1.0}))
    other_seeds = Path(shutil.copytree(runs[0], folder / "other-seeds"))
    samples = read_samples(other_seeds / "samples.npz")
    samples.seed[3] = 4
    write_samples(other_seeds / "samples.npz", samples)
    return {
        "Expected a finished run, got .*stopped": [stopped],
        "Expected the folder of a run, with result.json": [folder / "empty"],
        "Expected the folder of at least one run": [],
        r"Expected each seed of SADA-Analytic-v0.paper-budgets once, got 0 in both": [runs[0]] * 2,
        r"Expected the seeds 0, 1, 2 and so on": [runs[1]],
        "Expected afr = .* as the samples give it": [edited],
        "Expected the evaluation seeds of the test stream of seed 0 of": [other_seeds],
        "at most 1,000 queries, got 1,001. gaussian may spend 1,000 by the rule paper-budgets and "
        "2,000 by the rule equal-queries": [made_run(folder / "big", budget=1_001)],
        "application.settings.noise was 0.1 and is 0.0": [
            made_run(folder / "noisy", env_kwargs={"noise": 0.1})
        ],
        "seed: Input should be less than 9223372036854775808": [
            made_run(folder / "far", seed=2**63)
        ],
        "samples was 10 and is 250": [made_run(folder / "few", samples=10)],
        "Your own environments cannot take part": [
            made_run(folder / "own", environment=Toy(), adversary=Greedy)
        ],
        "of one adversary with one set of options, got the adversary 'memorise'": [
            runs[0],
            made_run(folder / "other", adversary="memorise", seed=1),
        ],
    }


def test_runs_that_do_not_fit_get_a_sentence(runs, tmp_path):
    for said, folders in spoilt_runs(tmp_path, runs).items():
        with pytest.raises(UserError, match=said):
            submit(folders, ME, out=tmp_path / "entries")
    assert not (tmp_path / "entries").exists()


def test_a_class_of_ones_own_takes_part(tmp_path):
    run = made_run(tmp_path / "run", adversary=Greedy, options={"best": 10})
    entry = submit([run], ME, out=tmp_path)
    assert entry.adversary.name == "greedy"
    assert entry.adversary.options == {"best": 10}
    assert entry.metadata.command == ""  # no command line knows the class


def test_what_is_wrong_shows_before_anything_is_evaluated(tmp_path, monkeypatch):
    submit_samples([MU], ME, **UNIFORM, out=tmp_path)
    monkeypatch.setattr("sada_gym.board.submission.submit.measure_samples", None)
    for metadata, changes, said in (
        (ME, {}, "Expected a new result"),
        (ME, {"adversary": "other", "rule": "equal-queries"}, "of one adversary with one set"),
        (made_by(authors=[]), {}, "Expected a text as authors"),
    ):
        with pytest.raises(UserError, match=said):
            submit_samples([MU], metadata, **(UNIFORM | changes), out=tmp_path)


def test_another_adversary_cannot_join_an_entry(runs, tmp_path):
    submit(runs, ME, rule="equal-queries", out=tmp_path)
    before = snapshot(tmp_path)
    with pytest.raises(UserError, match=r"got the adversary 'uniform' in .* beside 'gaussian' in"):
        submit_samples([MU], ME, **UNIFORM, out=tmp_path)
    assert snapshot(tmp_path) == before
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.txt").write_text("mine")
    with pytest.raises(UserError, match=r"Expected only entry.toml and results in .*'thesis.txt'"):
        submit(runs, made_by("other"), out=tmp_path)
    assert (other / "thesis.txt").read_text() == "mine"


def on_the_command_line(capsys, *words):
    with pytest.raises(SystemExit) as stopped:
        app(["submit", *map(str, words)])
    shown = capsys.readouterr()
    return stopped.value.code or 0, " ".join((shown.out + shown.err).split())


EMPTY = ("--options", "[]")
NAMED = ("--name", "mine", "--authors", "Ada L.", "--licence", "MIT")


def test_the_command_line_says_what_to_do_next(runs, tmp_path, capsys):
    code, shown = on_the_command_line(capsys, *runs, *NAMED, "--out", tmp_path)
    assert code == 0
    assert "SADA-Analytic-v0.paper-budgets: AFR " in shown
    assert "no coverage, 2 seeds" in shown
    assert "open a pull request" in shown


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "Expected the folder of at least one run"),
        (["--samples", "a.npy", "run"], "Expected runs or --samples, got both"),
        (["--samples", "a.npy", "--track", "x"], "Expected --queries and --adversary beside"),
        (["run", "--track", "x"], "Expected --track only with --samples"),
        (
            ["--samples", "a", "--track", "x", "--queries", 1, "--adversary", "x", *EMPTY],
            "Expected options that are a JSON object",
        ),
    ],
)
def test_wrong_words_get_a_sentence(tmp_path, capsys, words, said):
    code, shown = on_the_command_line(capsys, *words, *NAMED, "--out", tmp_path / "entries")
    assert code == 2
    assert said in shown
    assert not (tmp_path / "entries").exists()


def test_the_clones_script_is_the_command(tmp_path):
    np.save(tmp_path / "mu.npy", MU)
    words = ["--samples", "mu.npy", "--track", ANALYTIC, "--queries", "5", "--adversary", "zeros"]
    script = [sys.executable, str(ROOT / "leaderboard" / "submit.py")]
    done = subprocess.run([*script, *words, *NAMED], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "The entry passes all checks" in done.stdout
    check_entry(tmp_path / "leaderboard" / "entries" / "mine")
