"""The density of logged worlds: it sums to 1, draws what it says, and refuses bad tables."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm
from typer.testing import CliRunner

from sada_gym import attack, estimate
from sada_gym.analyses.estimation.table import TableDensity
from sada_gym.cli import app
from sada_gym.errors import UserError
from sada_gym.parameters import Parameter, ParameterSpace

SPACE = ParameterSpace(
    Parameter("wind", -4.0, 4.0),
    Parameter("road", 0.0, 3.0, choices=("dry", "wet", "ice")),
    Parameter("size", 0.1, 10.0, log=True),
)


def logged(count=400, seed=0):
    rng = np.random.default_rng(seed)
    wind = rng.normal(1.0, 0.8, count).clip(-4, 4)
    road = rng.choice(3, count, p=[0.7, 0.3, 0.0]) + 0.5
    return np.stack([wind, road, np.exp(rng.normal(0.0, 0.4, count))], axis=1)


def test_the_density_sums_to_one_and_draws_what_it_says():
    density = TableDensity(SPACE, logged())
    rng = np.random.default_rng(1)
    even = SPACE.physical(rng.uniform(-1, 1, (60_000, 3)))
    volume = 8.0 * 3.0 * even[:, 2] * np.log(100.0)  # by the logarithm of size
    mass = np.exp(density.logpdf(even)) * volume
    assert mass.mean() == pytest.approx(1.0, abs=0.03)
    drawn = density.rvs(size=60_000, random_state=rng)
    for where in (lambda x: x[:, 0] > 2.0, lambda x: x[:, 1] >= 2.0, lambda x: x[:, 2] < 0.7):
        assert where(drawn).mean() == pytest.approx((mass * where(even)).mean(), abs=0.02)
    assert np.isneginf(density.logpdf(np.array([[9.0, 0.5, 1.0]]))).all()
    assert density.held == 1.0


def test_choices_have_smoothed_frequencies_and_numbers_stay_near_the_rows():
    rows = logged()
    drawn = TableDensity(SPACE, rows).rvs(size=40_000, random_state=np.random.default_rng(2))
    seen = np.bincount(rows[:, 1].astype(int), minlength=3)
    shares = np.bincount(drawn[:, 1].astype(int), minlength=3) / len(drawn)
    np.testing.assert_allclose(shares, (seen + 1) / (len(rows) + 3), atol=0.01)
    assert shares[2] > 0.0  # never logged
    assert drawn[:, 0].mean() == pytest.approx(rows[:, 0].mean(), abs=0.05)
    assert drawn[:, 0].std() == pytest.approx(rows[:, 0].std(), rel=0.1)


def test_a_correlation_in_the_table_stays():
    space = ParameterSpace(Parameter("a", -4.0, 4.0), Parameter("b", -4.0, 4.0))
    rows = multivariate_normal([0, 0], [[1, 0.9], [0.9, 1]]).rvs(1_000, random_state=3)
    density = TableDensity(space, rows.clip(-4, 4))
    drawn = density.rvs(size=20_000, random_state=np.random.default_rng(4))
    assert np.corrcoef(drawn.T)[0, 1] > 0.8


def test_rows_outside_of_the_ranges_are_left_out_and_counted():
    rows = np.concatenate([logged(300), [[9.0, 0.5, 1.0]] * 100])
    density = TableDensity(SPACE, rows)
    assert density.held == 0.75
    assert len(density.rows) == 300
    assert density.data == {"table": {"rows": 400, "in_ranges": 300}}


@pytest.mark.parametrize(("dimension", "count"), [(2, 300), (8, 1_000)])
def test_tails_are_no_more_likely_than_in_the_table(dimension, count):
    space = ParameterSpace(*(Parameter(f"x{i}", -8.0, 8.0) for i in range(dimension)))
    density = TableDensity(space, np.random.default_rng(0).normal(size=(count, dimension)))
    drawn = density.rvs(200_000, np.random.default_rng(1))
    assert drawn.std(axis=0) == pytest.approx(density.rows.std(axis=0), rel=0.01)
    beyond = drawn.sum(axis=1) / dimension**0.5 > 3.0  # Scott's rule alone: 2.2 and 4.5 times
    assert beyond.mean() == pytest.approx(norm.sf(3.0), rel=0.6)


@pytest.mark.parametrize("spread", [0.0, 10.0, 400.0])
def test_angles_go_around(spread):
    space = ParameterSpace(
        Parameter("heading_deg", 0.0, 360.0, "deg", directions=("n", "w", "s", "e")),
        Parameter("wind", -5.0, 5.0),
    )
    rows = np.random.default_rng(0).normal(0.0, [spread, 1.0], (300, 2))
    density = TableDensity(space, rows)  # of -180 to 180, not 0 to 360
    assert density.held == 1.0
    drawn = density.rvs(20_000, np.random.default_rng(1))[:, 0]
    assert drawn.min() >= 0.0
    assert drawn.max() <= 360.0
    if spread < 100.0:
        near = (drawn + 180.0) % 360.0 - 180.0
        assert near.std() == pytest.approx(spread, rel=0.1, abs=1.0)
    grid = np.stack(np.meshgrid(np.linspace(0.0, 360.0, 7_201)[:-1], [-1.0, 1.0]), -1).reshape(
        -1, 2
    )
    mass = np.exp(density.logpdf(grid)).reshape(2, -1).mean(axis=0)
    half = mass[:3_600].sum() / mass.sum()
    assert (drawn < 180.0).mean() == pytest.approx(half, abs=0.05)
    ends = density.logpdf(np.array([[0.0, 0.0], [360.0, 0.0]]))
    assert ends[0] == pytest.approx(ends[1])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (logged(19), "at least 20 worlds in the ranges, got 19 of 19"),
        (logged(40) + np.array([9.0, 0.0, 0.0]), "at least 20 worlds in the ranges, got"),
        (np.where(np.arange(120).reshape(40, 3) == 7, np.nan, 1.0), "got nan as road in row 3"),
        (np.ones((40, 2)), r"shape \(n, 3\) as density, in the order wind, road, size"),
        ([["calm", 1, 2]] * 40, "a table of numbers"),
    ],
)
def test_bad_tables_get_a_sentence(rows, message):
    with pytest.raises(UserError, match=message):
        TableDensity(SPACE, rows)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wind,road\n1,dry\n", "got none named size"),
        ("", "got none named wind among nothing"),
        ("Wind,Road,Size\n", "got none named wind among Wind, Road, Size"),
        ("wind,road,size\n1,dry\n", "a number as size in row 1 of .*, got ''"),
        ("wind;road;size\n0,5;dry;1\n", "a number as wind in row 1 of .*, got '0,5'"),
        ("wind,road,size\n" + "1,dry,1\n" * 30 + "1,mud,1\n", "dry, wet, ice as road in row 31"),
        ("wind,road,size\n" + ",dry,1\n" * 30, "a number as wind in row 1"),
        ("wind,road,size\n", "got 0 of 0"),
    ],
)
def test_bad_files_get_a_sentence(text, message, tmp_path):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(UserError, match=message):
        TableDensity(SPACE, tmp_path / "log.csv")


@pytest.mark.parametrize("separator", [",", ";", "\t", ", "])
def test_files_of_other_programs_are_read(separator, tmp_path):
    lines = [separator.join(["wind", "road", "size"]), *[separator.join(["1.5", "wet", "2"])] * 20]
    (tmp_path / "log.csv").write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).encode())
    assert TableDensity(SPACE, tmp_path / "log.csv").rows.tolist() == [[1.5, 1.5, 2.0]] * 20


@pytest.mark.long
def test_a_run_takes_a_table_and_shows_it(tmp_path):
    run = attack(
        "SADA-Analytic-v0", "random", budget=0, samples=30, pictures=False, out=tmp_path / "run"
    )
    rows = np.random.default_rng(0).normal(0.0, 0.2, (100, 2))
    lines = [f"{b},{a},7" for a, b in rows.clip(-1, 1).tolist()]
    log = "\n".join(["x1,x0,note", *lines])
    (tmp_path / "log.csv").write_text(log)
    words = ["estimate", str(run.folder), "--budget", "60", "--density", str(tmp_path / "log.csv")]
    (tmp_path / "log.tsv").write_text(log.replace(",", "\t"))
    tabs = [*words[:-1], str(tmp_path / "log.tsv")]
    assert CliRunner().invoke(app, tabs).exit_code == 0
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    told = {"path": str(tmp_path / "log.csv"), "sha256": hashlib.sha256(log.encode()).hexdigest()}
    assert content["density"] == {"table": {"rows": 100, "in_ranges": 100, **told}}
    assert (run.folder / "density.png").read_bytes()[:4] == b"\x89PNG"
    assert estimate(run, budget=60, density=rows.clip(-1, 1)).probability == content["probability"]
