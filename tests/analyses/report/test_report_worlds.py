"""worlds.csv, and worlds.json beside it."""

import csv
import io

import numpy as np
import pytest
from hostile_worlds import FORMULA, TAG, Hostile
from toy import Greedy

from sada_gym import attack
from sada_gym.measures.diagnosis.record import Condition, SumCondition
from sada_gym.run.worlds import WorldColumns, parameters_of, plain, read_columns, weakness_of


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("worlds") / "run"
    application = Hostile()
    return attack(application, Greedy, out=folder, budget=30, seed=2, progress=False)


def read(folder):
    content = (folder / "worlds.csv").read_bytes()
    assert content.count(b"\r\n") == content.count(b"\n"), "RFC 4180"
    return list(csv.DictReader(io.StringIO(content.decode("utf-8"), newline="")))


def test_it_has_a_row_for_each_sample_and_query(result):
    rows = read(result.folder)
    assert [row["role"] for row in rows] == ["sample"] * 40 + ["query"] * 30
    assert [int(row["row"]) for row in rows] == [*range(40), *range(30)]
    both = result.samples + result.queries
    assert [float(row["score"]) for row in rows] == both.score.tolist()
    assert [int(row["seed"]) for row in rows] == both.seed.tolist()
    assert [row["fooled"] == "1" for row in rows] == both.fooled(0.3).tolist()


def test_values_are_physical_and_read_back(result):
    rows = read(result.folder)
    physical = Hostile.parameters.physical((result.samples + result.queries).mu)
    columns = read_columns(result.folder)
    speed, logarithmic, kind, count, angle = (column.column for column in columns.parameters)
    assert [float(row[plain(logarithmic)]) for row in rows] == physical[:, 1].tolist()
    assert {row[kind] for row in rows} == {"'@SUM(A1)", "-1", 'a "b", c'}
    assert {int(row[count]) for row in rows} == {1, 2, 3, 4}
    assert speed == f"{TAG} [m/s]"
    assert angle == "score [deg]"
    assert columns.space.parameters == Hostile.parameters.parameters


def test_no_text_of_a_user_is_a_formula(result):
    rows = read(result.folder)
    texts = [*rows[0], *(value for row in rows for value in row.values())]
    for text in texts:
        if text.startswith(("=", "+", "-", "@")):
            float(text)  # a number
    assert f"'{FORMULA}" in rows[0]
    assert "'+hit <a gate>" in {row["behaviour"] for row in rows}


@pytest.mark.parametrize("name", ["score", "seed", "row"])
def test_a_parameter_with_the_name_of_a_column_gets_another(name):
    class Named(Hostile):
        parameters = type(Hostile.parameters)(
            type(Hostile.parameters.parameters[0])(name, 0.0, 1.0),
            type(Hostile.parameters.parameters[0])(f"{name} (parameter)", 0.0, 1.0),
        )

    columns = [column.column for column in WorldColumns.of(Named()).parameters]
    assert len({*columns, name}) == 3


def test_a_rule_on_a_parameter_that_is_not_there_holds_nowhere(result):
    condition = Condition(parameter="count", ranges=((0.5, 2.5),), text="count is at most 2")
    unknown = condition.model_copy(update={"parameter": "other"})
    mu = result.samples.mu
    assert not weakness_of([[unknown]], Hostile.parameters, mu).any()
    first = weakness_of([[unknown], [condition], [condition]], Hostile.parameters, mu)
    assert {*first.tolist()} == {0, 2}
    fields = condition.model_dump()
    total = SumCondition(**{**fields, "ranges": ((-1e9, 1e9),)}, other="score", factor=2.0)
    assert parameters_of([total, condition]) == ["count", "score"]
    assert weakness_of([[total]], Hostile.parameters, mu).all()
    beyond = total.model_copy(update={"other": "nothing"})
    assert not weakness_of([[beyond]], Hostile.parameters, mu).any()


def test_a_run_without_pictures_has_the_table_too(tmp_path):
    result = attack("SADA-Analytic-v0", "random", out=tmp_path / "run", budget=0, samples=20,
                    pictures=False, progress=False)  # fmt: skip
    assert result.html is None
    assert not (result.folder / "report.html").exists()
    rows = read(result.folder)
    assert len(rows) == 20
    values = np.array([[float(row["x0"]), float(row["x1"])] for row in rows])
    np.testing.assert_array_equal(values, result.samples.mu.astype(np.float64))
