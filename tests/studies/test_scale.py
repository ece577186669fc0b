"""The study of the scale of Q trains what its record lacks, and judges by Q itself."""

import json
import sys

import pytest

from studies import scale as study


def figures(afr, coverage, sample="a"):
    return {
        "afr": afr,
        "low": afr - 0.05,
        "high": afr + 0.05,
        "coverage": coverage,
        "sample": sample,
        "seconds": 1.0,
    }


@pytest.mark.parametrize(
    ("second", "kept"), [((0.78, 0.95), True), ((0.65, 0.95), False), ((0.78, 0.8), False)]
)
def test_the_contract_needs_overlapping_rates_and_close_coverages(second, kept):
    assert study.keeps([figures(0.8, 0.99), figures(*second)]) is kept


def test_a_second_run_reads_the_record(tmp_path, monkeypatch, capsys):
    record = tmp_path / "deep" / "scale.jsonl"
    command = ["scale.py", "--adversaries", "gaussian", "--seeds", "1", "--record", str(record)]
    monkeypatch.setattr(sys, "argv", command)
    monkeypatch.setattr(study, "BUDGET", 60)
    study.main()
    first, rows = capsys.readouterr().out, record.read_text().splitlines()
    assert "`gaussian`" in first.splitlines()[-1]
    assert "| = | = | = | 1 of 1 |" in first  # it sees the order of the scores alone
    assert [json.loads(row)["scale"] for row in rows] == ["Q", "Q^4", "log Q", "rank Q"]
    monkeypatch.setattr(study, "train", None)  # nothing is trained again
    study.main()
    assert capsys.readouterr().out == first
    assert record.read_text().splitlines() == rows
