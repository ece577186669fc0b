"""`sada-gym transfer` and `sada-gym confirm`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sada_gym.cli import app


def run(*args: str | Path):
    return CliRunner().invoke(app, [*map(str, args)], env={"COLUMNS": "200"})


@pytest.fixture(scope="module")
def analytic(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "a run"
    words = "attack SADA-Analytic-v0 -a random --budget 0 --samples 20 --workers 1 --out"
    assert run(*words.split(), folder).exit_code == 0
    return folder


def test_transfer_prints_a_table_and_writes_the_figures(analytic, tmp_path):
    out = tmp_path / "figures.json"
    result = run(
        *("transfer", analytic, analytic, "--to", "SADA-Analytic-v0"),
        *("--env-kwargs", "volume=0.5", "--out", out),
    )
    assert result.exit_code == 0, result.output
    assert result.stdout.count("SADA-Analytic-v0 with volume=0.5") == 2
    assert result.stdout.count(f"20 samples of {analytic}") == 1
    rows = json.loads(out.read_text())["comparisons"]
    assert [row["keywords"] for row in rows] == [{"volume": 0.5}] * 2
    assert f"{rows[0]['both']['fooled']} of {rows[0]['both']['samples']}" in result.stdout
    printed = run("transfer", analytic, "--env-kwargs", "volume=0.5", "--json")
    assert json.loads(printed.stdout)["comparisons"] == rows[:1]


def test_confirm_prints_what_was_confirmed(analytic):
    result = run("confirm", analytic, "--env-kwargs", "volume=0.05")
    assert result.exit_code == 0, result.output
    content = json.loads((analytic / "confirmed.json").read_text())
    assert f"of the {content['both']['samples']} samples that fool in the run" in result.stdout
    assert f"{analytic / 'confirmed.json'}, confirmed.npz" in result.stdout
    printed = run("confirm", analytic, "--env-kwargs", "volume=0.05", "--json")
    assert json.loads(printed.stdout) == content


def test_confirm_without_keywords_tries_the_failures_on_fresh_seeds(analytic):
    result = run("confirm", analytic, "--seeds", 2)
    assert result.exit_code == 0, result.output
    content = json.loads((analytic / "failures.json").read_text())
    again = f"{content['confirmed']['fooled']} of {content['confirmed']['samples']}"
    assert f"confirmed: {again} fail again on fresh seeds" in result.stdout
    printed = run("confirm", analytic, "--seeds", 2, "--json")
    assert json.loads(printed.stdout) == content


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["transfer", "nowhere", "--to", "SADA-Analytic-v0"], "which holds no attack.json"),
        (["transfer", "{run}"], "Expected a track, an agent, keywords or a seed"),
        (["transfer", "{run}", "--to", "no.toml"], "no.toml"),
        (["transfer", "{run}", "--to", "SADA-Analytic-v0", "--out", "no/x.json"], "no/x.json"),
        (["confirm", "{run}", "--samples", 3], "Expected --samples and --out with --env-kwargs"),
        (["confirm", "{run}", "--env-kwargs", "volume=0.1", "--seeds", 2], "got both"),
        (["confirm", "{run}", "--env-kwargs", "volume"], "Expected --env-kwargs key=value"),
    ],
)
def test_bad_input_is_one_sentence(analytic, args, message):
    result = run(*(str(word).format(run=analytic) for word in args))
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert "Traceback" not in result.output
