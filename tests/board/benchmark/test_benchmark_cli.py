import io
import os
import re
import shlex
import signal
import time

import pytest
from bench_toys import ANALYTIC, LOGGED, make_reference, suite
from interrupting import start_interruptible
from rich.console import Console
from rich.text import Text
from typer.testing import CliRunner

from sada_gym.board.benchmark.entries import Missing
from sada_gym.board.benchmark.folder import Timing
from sada_gym.board.benchmark.plan import make_plan
from sada_gym.board.benchmark.results import results_of
from sada_gym.board.benchmark.suite import SUITES, TABLES
from sada_gym.board.results.entry import read_entries
from sada_gym.cli import app
from sada_gym.cli.benchmark_progress import BenchmarkProgress
from sada_gym.experiment.algorithm import RunProgress

SMALL = ["--track", ANALYTIC, "--budget", "60", "--samples", "20", "--images", "0"]


def run(*args):
    return CliRunner().invoke(app, ["benchmark", *map(str, args)], env={"COLUMNS": "200"})


@pytest.fixture(scope="module")
def references(tmp_path_factory):
    folder = tmp_path_factory.mktemp("references")
    make_reference(folder, ANALYTIC)
    return folder


@pytest.fixture(scope="module")
def done(tmp_path_factory, references):
    out = tmp_path_factory.mktemp("cli") / "out"
    names = ("ideal", "random", "memorise", "toy:Greedy", "bench_toys:Picky")
    chosen = [word for name in names for word in ("-a", name)]
    result = run(*SMALL, *chosen, "--workers", 1, "--out", out, "--references", references)
    assert result.exit_code == 0, result.output
    return out, result


def test_it_tells_of_every_run_and_ends_with_the_table(done):
    out, result = done
    todo = "5 runs to do: 5 results are missing or incomplete, 0 are outdated and will be repeated."
    assert result.stdout.splitlines()[0] == todo
    lines = re.findall(r"^\d/5 runs: .*", result.stdout, re.MULTILINE)
    assert len(lines) == 5
    assert "queries/s" in lines[2]
    assert "left" in lines[2]
    table = result.stdout.partition("Equal queries")[2]
    assert re.search(r"toy:Greedy +│ +\d+\.\d │ +1", table)
    assert re.search(r"Picky( +│ +-?)+ +│ +0, 1 failed", table)
    assert f"Results: {out / 'entries'}/; to read: {out}/ (table.md" in table


def test_its_files_tell_the_same(done):
    out, _ = done
    results = results_of(read_entries(out / "entries"), [TABLES["equal-queries"]])
    assert [run.label for run in results.runs] == [
        "ideal",
        "random",
        "memorise",
        "bench_toys:Picky",
        "toy:Greedy",
    ]
    afr = {row.label: row.afr for row in results.rows_of("equal-queries", "", None)}
    text = (out / "table.md").read_text()
    assert re.search(rf"\| random \| [^|]+ \| 1= \| {100 * afr['random'].value:.1f} \(", text)
    assert "| bench_toys:Picky | - |" in text
    assert "0, 1 failed (incomplete)" in text
    assert "- bench_toys:Picky (equal-queries, one run): failed: Expected a budget of" in text
    attacked = text.partition("## What was attacked")[2]
    assert "| full set | fooling set |" in attacked
    assert len(re.findall(r"\| \d+\.\d % \| \d+\.\d % \|", attacked)) == 1
    assert "Training queries: 60; ideal none; random none." in text


def test_report_alone_runs_nothing(done, references):
    out, _ = done
    table = (out / "table.md").read_bytes()
    (out / "table.md").unlink()
    result = run("--report", "--out", out, "--references", references)
    assert result.exit_code == 0, result.output
    assert "runs:" not in result.stdout
    assert (out / "table.md").read_bytes() == table


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (
            ["--suite", "papers"],
            f"Expected the suite to be one of {', '.join(suite.name for suite in SUITES)}; "
            "got 'papers'",
        ),
        (["--table", "paper-budgets"], "Expected the table to be one of equal-queries"),
        (["--track", "SADA-Analytc-v0"], "Did you mean 'SADA-Analytic-v0'"),
        ([*SMALL, "-a", "randm"], "Did you mean random"),
        (
            [*SMALL, "-a", "random", "-a", "nowhere:Nothing"],
            "Install the module, or set PYTHONPATH",
        ),
        ([*SMALL, "-a", "bbgan:papr"], "Expected the preset to be one of default, paper"),
        ([*SMALL, "-a", "random", "--agent", "surveyor"], "got 'agent'"),
        (["--track", "SADA-Detection-Car-v0", "--agent", "surveyer"], "Did you mean 'surveyor'"),
        ([*SMALL, "--seeds", "0"], "seeds"),
        (["--track", ANALYTIC, "SADA-UAV-v0"], "got 'SADA-UAV-v0' without one"),
        (["--report", "--plan"], "Expected --plan or --report, got both"),
        (["--report", "--out", "none"], "Expected a benchmark's folder, got none without"),
        ([*SMALL, "-a", "random", "--out", "file"], "got the file file"),
        ([*SMALL, "-a", "random", "--out", "."], "which holds something else"),
    ],
)
def test_bad_input_gets_a_sentence(args, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    result = run(*args)
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert "Traceback" not in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_help_names_every_suite():
    listed = run("--help").stdout.replace(",", " ").replace(".", " ").split()
    assert {suite.name for suite in SUITES} <= set(listed)


@pytest.mark.long
def test_outdated_results_are_counted_and_made_anew(tmp_path, references):
    chosen = ["--track", ANALYTIC, "-a", "random", "-a", "ideal", "--samples", 20, "--images", 0]
    chosen += ["--out", tmp_path / "out", "--entries", tmp_path / "entries"]
    chosen += ["--references", references, "--workers", 1]
    assert run(*chosen, "--budget", 60).exit_code == 0
    result = run(*chosen, "--budget", 61, "-a", "toy:Greedy")
    assert result.exit_code == 0, result.output
    todo = (
        "2 runs to do: one result is missing or incomplete, one is outdated and will be repeated."
    )
    assert result.stdout.splitlines()[0] == todo
    assert "No result is missing" in run(*chosen, "--budget", 61).stdout
    assert not (tmp_path / "out" / "entries").exists()
    budgets = {
        entry.metadata.name: [
            result.experiment.protocol.budget for result in entry.results.values()
        ]
        for entry in read_entries(tmp_path / "entries")
    }
    assert budgets == {"random": [61], "ideal": [0], "toy-greedy": [61]}


def test_a_plan_tells_of_runs_and_costs_and_makes_nothing(done, references, tmp_path):
    out, _ = done
    chosen = ["-a", "random", "-a", "toy:Greedy", "-a", "gaussian", "--references", references]
    result = run(*SMALL, *chosen, "--seeds", 2, "--out", out, "--plan")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("4 runs to do: 3 results are missing or incomplete, 0 are")
    row = next(line for line in result.stdout.splitlines() if ANALYTIC in line)
    cells = [cell.strip() for cell in row.strip("│┃ ").split("│")]
    assert cells[:4] == ["equal-queries", ANALYTIC, "4", "320"]  # 60 + 20 each
    assert re.fullmatch(r"\d+\.\d\d \+ 2 unknown", cells[4])
    assert "without 2 runs of kinds that were never timed" in result.stdout
    result = run(*SMALL, *chosen, "--out", tmp_path / "new", "--plan")
    assert result.stdout.startswith("3 runs to do")
    assert "unknown" in result.stdout
    assert list(tmp_path.iterdir()) == []
    done_already = [*chosen[:4], "--references", references, "--out", out]
    assert "No result is missing" in run(*SMALL, *done_already, "--plan").stdout


def timing(evaluated, wall_s):
    return Timing(
        training_s=0.0,
        evaluation_s=0.0,
        evaluated=evaluated,
        known=0,
        wall_s=wall_s,
        peak_memory_mib=None,
    )


def test_a_terminal_shows_runs_rate_time_left_and_each_process(tmp_path):
    plan = make_plan(suite("random", "toy:Greedy", budgets=(60,), seeds=2), tmp_path)
    first, second = plan.groups[0].runs
    console = Console(force_terminal=True, width=120, file=io.StringIO())
    with BenchmarkProgress(console) as bars:
        bars.on_start(plan, Missing(tuple(plan.runs), lacking=2, outdated=0))
        bars.on_progress(first, RunProgress("test", 10, 30, evaluated=10))
        bars.on_finish(first, timing(evaluated=30, wall_s=65.0))
        bars.on_progress(plan.groups[1].runs[0], RunProgress("train", 0, 60))
        bars.on_progress(second, RunProgress("train", 5, 60, evaluated=5))
        bars._bars.refresh()
        shown = Text.from_ansi(console.file.getvalue()).plain
        bars.on_finish(second, timing(evaluated=5, wall_s=65.0))
        bars.on_report()
    assert re.search(r"Runs.* 1/4  35 queries/s, about 1:37 left", shown)
    assert re.search(r"Analytic seed 0.* 1/2  toy:Greedy \(n60\): train 5/60", shown)
    assert re.search(r"Analytic seed 1.* 0/2  random \(n60\): train 0/60", shown)
    assert "writing the report" in Text.from_ansi(console.file.getvalue()).plain


@pytest.mark.long
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="sends a signal as a terminal does")
def test_ctrl_c_keeps_what_is_finished_and_says_how_to_go_on(tmp_path):
    out, log = tmp_path / "an out", tmp_path / "log"
    command = ["benchmark", "--track", LOGGED, "--seeds", "1", "-a", "random", "-a", "toy:Greedy"]
    command += ["--budget", "900", "--images", "0", "--executor", "processes", "--out", str(out)]
    process = start_interruptible(command, TOY_LOG=str(log), TOY_PAUSE_S="0.01")
    while process.poll() is None and (not log.exists() or log.read_text().count("\n") < 100):
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, printed = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in printed
    assert f"Stopped. 1 finished runs and all evaluations are saved in {out}" in printed
    assert shlex.split(printed.strip().splitlines()[-1]) == ["sada-gym", *command]


NO_NAME = "a" * 300


@pytest.mark.parametrize(
    "words",
    [
        ["benchmark", "--report", "--out", NO_NAME],
        ["benchmark", "--report", "--entries", NO_NAME],
        ["benchmark", "--track", "SADA-Analytic-v0", "--entries", NO_NAME],
        ["benchmark", "--track", "SADA-Analytic-v0", "--references", NO_NAME],
    ],
    ids=["report", "reported entries", "entries", "references"],
)
def test_a_name_that_is_too_long_gets_a_sentence(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2, result.output
    assert "its name is too long" in result.stderr
    assert "Traceback" not in result.output
