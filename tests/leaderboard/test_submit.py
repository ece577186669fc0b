import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from made_entries import ANALYTIC, make_entry
from sada_gym.submission.entry import read_entry, write_verified
from sada_gym.submission.models import Verified
from sada_gym.submission.samples import samples_sha256
from toy import Greedy, Toy

from sada_gym.attack import attack
from sada_gym.cli import app
from sada_gym.errors import UserError
from sada_gym.submission.checks import check_entry
from sada_gym.submission.submit import Credits, submit, submit_samples

ROOT = Path(__file__).parents[2]
ME = Credits("mine", ["Ada L."], "CC-BY-4.0")
UNIFORM = {"track": ANALYTIC, "adversary": "uniform", "queries": 10}


def made_run(folder, **changes):
    told = {"environment": ANALYTIC, "adversary": "gaussian", "budget": 100, "pictures": False}
    attack(**(told | changes), out=folder)
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    return [made_run(folder / f"{seed}", seed=seed) for seed in range(2)]


def stem(rule="paper-budgets"):
    return f"{ANALYTIC}.{rule}"


def snapshot(folder):
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_runs_become_an_entry(runs, tmp_path):
    entry = submit(runs, ME, out=tmp_path)
    assert entry.folder == tmp_path / "mine"
    result = entry.results[stem()]
    assert [one.seed for one in result.claimed.seeds] == [0, 1]
    assert result.claimed.identity.budget == 1_000
    assert [one.queries for one in result.claimed.seeds] == [100, 100]
    assert result.claimed.seeds[0].search.queries == 100
    assert entry.about.title == "mine"
    assert entry.about.command == (
        "sada-gym attack SADA-Analytic-v0 --adversary gaussian --budget 100 --seed 0"
    )
    check_entry(entry.folder)


def test_results_join_an_entry_and_replace_only_when_told(runs, tmp_path):
    submit(runs, ME, out=tmp_path)
    entry = submit(runs[:1], ME, rule="equal-queries", out=tmp_path)
    assert list(entry.results) == [stem("equal-queries"), stem()]
    before = snapshot(tmp_path)
    with pytest.raises(UserError, match=r"Expected a new result, got .* Replace it by --replace"):
        submit(runs[:1], ME, out=tmp_path)
    assert snapshot(tmp_path) == before
    entry = submit(runs[:1], ME, out=tmp_path, replace=True)
    assert len(entry.results[stem()].claimed.seeds) == 1


def test_what_was_verified_of_other_results_stays(runs, tmp_path):
    entry = submit(runs, ME, out=tmp_path)
    result = entry.results[stem()]
    verified = Verified.make(result.claimed, result.samples, "1")
    write_verified(entry.folder, stem(), verified)
    entry = submit(runs[:1], ME, rule="equal-queries", out=tmp_path)
    assert {name: one.tier for name, one in entry.results.items()} == {
        stem(): "verified",
        stem("equal-queries"): "claimed",
    }
    entry = submit(runs[:1], ME, out=tmp_path, replace=True)
    assert entry.results[stem()].tier == "claimed"


def test_an_entry_is_labelled_anew(tmp_path):
    made = make_entry(tmp_path / "benchmark", "ours")
    entry = submit([made], ME, out=tmp_path)
    assert (entry.about.name, entry.about.adversary) == ("mine", "my-method")
    (ours,), (mine,) = read_entry(made).results.values(), entry.results.values()
    assert mine.claimed == ours.claimed
    with pytest.raises(UserError, match="Expected results by the rule equal-queries in"):
        submit([made], ME, rule="equal-queries", out=tmp_path)


def test_samples_become_an_entry_as_the_same_run_does(runs, tmp_path):
    drawn = [np.load(run / "samples.npz")["mu"] for run in runs]
    np.save(tmp_path / "mu1.npy", drawn[1].astype(np.float64))
    told = UNIFORM | {"adversary": "optuna-tpe", "options": {"trials": 10}}
    entry = submit_samples([drawn[0], tmp_path / "mu1.npy"], ME, **told, out=tmp_path / "entries")
    ours = submit(runs, Credits("run", ["Ada L."], "MIT"), out=tmp_path / "entries")
    mine, theirs = entry.results[stem()], ours.results[stem()]
    assert samples_sha256(mine.samples) == samples_sha256(theirs.samples)
    for a, b in zip(mine.claimed.seeds, theirs.claimed.seeds, strict=True):
        assert a.queries == 10
        assert a.search is None
        assert a.measures == b.measures.model_copy(update={"novelty": None})
    assert entry.about.options == '{"trials": 10}'


def test_ideal_samples_are_evaluated_where_there_is_a_reference_set(tmp_path):
    told = {"track": "SADA-Digits-3-v0", "adversary": "uniform", "queries": 0}
    mu = np.random.default_rng(0).uniform(-1, 1, (250, 6))
    entry = submit_samples([mu], ME, **told, out=tmp_path)
    run = made_run(tmp_path / "run", environment="SADA-Digits-v0", env_kwargs={"digit": 3})
    (seed,) = entry.results["SADA-Digits-3-v0.cnn.paper-budgets"].claimed.seeds
    assert 0.5 < seed.measures.relative_coverage < 1
    # a general id with the track's keywords is the track
    same = submit([run], Credits("same", ["Ada L."], "MIT"), out=tmp_path)
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
        ([MU], {"adversary": ""}, "Expected a text as adversary in .*mine/entry.toml"),
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
    ],
)
def test_credits_that_do_not_fit_get_a_sentence(runs, tmp_path, changes, said):
    told = {"name": "mine", "authors": ["Ada L."], "licence": "MIT"}
    with pytest.raises(UserError, match=said) as caught:
        submit(runs, Credits(**(told | changes)), out=tmp_path / "entries")
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
    return {
        "Expected a finished run, got .*stopped": [stopped],
        "Expected the folder of a run, with result.json": [folder / "empty"],
        "Expected the folder of at least one run": [],
        r"Expected each seed of SADA-Analytic-v0.paper-budgets once, got 0 in both": [runs[0]] * 2,
        r"Expected the seeds 0, 1, 2 and so on": [runs[1]],
        "Expected afr = .* as its samples give it": [edited],
        "at most 1,000 queries, got 1,001. gaussian may spend 1,000 by the rule paper-budgets and "
        "2,000 by the rule equal-queries": [made_run(folder / "big", budget=1_001)],
        "application_settings.noise was 0.1 and is 0.0": [
            made_run(folder / "noisy", env_kwargs={"noise": 0.1})
        ],
        "samples was 10 and is 250": [made_run(folder / "few", samples=10)],
        "Environments of one's own cannot take part": [
            made_run(folder / "own", environment=Toy(), adversary=Greedy)
        ],
        "of one adversary with one set of options, got the adversary 'archive'": [
            runs[0],
            made_run(folder / "other", adversary="archive", seed=1),
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
    assert entry.about.adversary == "greedy"
    assert entry.about.options == '{"best": 10}'
    assert entry.about.command == ""  # no command line knows the class


def test_what_is_wrong_shows_before_anything_is_evaluated(tmp_path, monkeypatch):
    submit_samples([MU], ME, **UNIFORM, out=tmp_path)
    monkeypatch.setattr("sada_gym.submission.submit.Evaluator", None)
    for credits, changes, said in (
        (ME, {}, "Expected a new result"),
        (ME, {"adversary": "other", "rule": "equal-queries"}, "of one adversary with one set"),
        (Credits("mine", [], "MIT"), {}, "Expected a text as authors"),
    ):
        with pytest.raises(UserError, match=said):
            submit_samples([MU], credits, **(UNIFORM | changes), out=tmp_path)


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
        submit(runs, Credits("other", ["Ada L."], "MIT"), out=tmp_path)
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
    told = ["--samples", "mu.npy", "--track", ANALYTIC, "--queries", "5", "--adversary", "zeros"]
    script = [sys.executable, str(ROOT / "leaderboard" / "submit.py")]
    done = subprocess.run([*script, *told, *NAMED], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "The entry passes all checks" in done.stdout
    check_entry(tmp_path / "leaderboard" / "entries" / "mine")
