import csv
import io
import json
from dataclasses import replace

import pytest
from made_board import CARDS, DIGITS, FLAG, HOSTILE, RACING, Made, make_entries

from leaderboard.board import make_board
from leaderboard.entry_page import describe, entry_page, is_web, made_by
from leaderboard.pictures import Pictures
from sada_gym.board.benchmark.plan import AUTHORS
from sada_gym.board.benchmark.results import results_of
from sada_gym.board.benchmark.suite import tables_of
from sada_gym.board.results.entry import read_entries
from sada_gym.board.results.front import HEIGHT, WIDTH, make_chart
from sada_gym.board.results.sheet import Cell, Column, Line, Sheet, text_cell
from sada_gym.foundations.cards import find_card

RATES = {"random": 0.24, "strong": 0.9}


@pytest.fixture(scope="module")
def entries(tmp_path_factory):
    return read_entries(make_entries(tmp_path_factory.mktemp("board") / "entries"))


@pytest.fixture(scope="module")
def board(entries):
    return make_board(entries, CARDS)


def group(board, name):
    return next(page for page in board.groups if page.card.page == name)


def rankings(board, name):
    ((_, of_tiers),) = group(board, name).comparisons
    return {ranking.tier: ranking for ranking in of_tiers}


def column(sheet, key):
    return {
        line.cells["entry"].text: line.cells[key].text for line in sheet.lines if key in line.cells
    }


def test_a_tier_ranks_its_own_figures_alone(board):
    tiers = rankings(board, "digits")
    assert column(tiers["verified"].whole, "rank") == {
        HOSTILE: "1=",
        "=level": "1=",
        "ideal": "",
        "middle": "3",
        "boaster": "4",
        "weak": "5",
    }
    claimed = column(tiers["claimed"].whole, "rank")
    assert list(claimed)[:2] == ["boaster", "newcomer"]  # by what they claim
    assert {name: claimed[name] for name in ("boaster", "newcomer", "weak")} == {
        "boaster": "1=",  # above the AFR of the ideal, both count as good as that
        "newcomer": "1=",
        "weak": "6",
    }
    assert column(tiers["claimed"].whole, "tier")["newcomer"] == "claimed"
    assert set(column(tiers["verified"].whole, "tier").values()) == {"verified"}
    assert tiers["claimed"].open  # the newcomer is in no other tier


def test_figures_are_those_of_the_benchmark(board, entries):
    sheet = rankings(board, "digits")["verified"].whole
    plain = [entry for entry in entries if entry.metadata.name in ("middle", "weak")]
    results = results_of(plain, tables_of({"paper-budgets"}), tier="verified")
    for row in results.rows_of("paper-budgets", "cnn", None):
        cells = next(line.cells for line in sheet.lines if line.cells["entry"].text == row.label)
        assert cells["afr"].value == row.afr.value
        assert cells["afr"].interval == row.afr.interval_95
        assert cells["coverage"].value == row.coverage.value
        assert cells["seeds_sd"].value == pytest.approx(0.02 / 2**0.5)  # as the seeds were made
        assert cells["seeds_sd"].note == "2 seeds"


def test_grey_rows_have_no_rank(board):
    for name in ("digits", "racing"):
        for ranking in rankings(board, name).values():
            for line in ranking.whole.lines:
                rank = line.cells.get("rank", Cell())
                assert (rank.value is not None) == (line.kind == "ranked")


def test_what_did_not_run_everywhere_stands_apart_and_last(tmp_path):
    made = (Made("best-of-one", 0.96, tracks=DIGITS[:1]), Made("everywhere", 0.6))
    board = make_board(read_entries(make_entries(tmp_path / "entries", made)), CARDS)
    ranking = rankings(board, "digits")["verified"]
    assert column(ranking.whole, "rank") == {"everywhere": "1"}
    assert column(ranking.partial, "rank") == {"best-of-one": ""}
    names = [line.cells["entry"].text for line in ranking.by_track.lines]
    assert names[:2] == ["everywhere", "best-of-one"]


def test_nothing_stands_apart_where_all_ran_everywhere(board):
    assert rankings(board, "digits")["verified"].partial is None


def test_without_a_reference_set_uniform_worlds_have_the_rate_of_the_entry_that_draws_them(
    tmp_path,
):
    robot = ("SADA-Robot-Warehouse-v0",)
    made = tuple(Made(name, rate, "", robot, "ppo-randomised") for name, rate in RATES.items())
    cards = [find_card("SADA-Robot")]
    board = make_board(read_entries(make_entries(tmp_path / "entries", made)), cards)
    lines = {line.cells["agent"].text: line.cells for line in board.strongest.lines}
    assert lines["ppo-randomised"]["uniform_rate"].text == "23.0"  # of 24 % and 22 %
    assert lines["ppo"]["uniform_rate"].text == "47.0"  # its reference set's


def test_the_papers_numbers_stand_beside_ours(board):
    ranking = rankings(board, "racing")["claimed"]
    lines = {line.cells["entry"].text: line for line in ranking.by_track.lines}
    assert lines["BBGAN (boost) · AAAI 2020"].kind == "paper"
    assert [lines["BBGAN (boost) · AAAI 2020"].cells[track].text for track in RACING] == [
        "86.0",
        "98.0",
        "92.0",
    ]
    assert column(ranking.whole, "afr")["BBGAN (boost) · AAAI 2020"] == "92.0"
    assert "Bayesian · AAAI 2020" not in lines  # a dash in the paper
    assert not any(
        "AAAI" in name for name in column(rankings(board, "digits")["claimed"].whole, "afr")
    )


def test_the_papers_numbers_wait_for_the_first_entry():
    board = make_board([], [find_card("SADA-UAV"), find_card("SADA-Digits")])
    sheets = {page.card.page: page.paper_sheet for page in board.groups}
    assert sheets["digits"] is None  # the paper has no digits
    assert [line.kind for line in sheets["racing"].lines] == ["paper"] * 9 + ["reference"]
    assert sheets["racing"].lines[0].cells[RACING[0]].text == "17.0"


def test_uniform_worlds_have_the_rate_of_the_reference_set(board):
    sheet = rankings(board, "digits")["verified"].by_track
    (line,) = [line for line in sheet.lines if line.kind == "reference"]
    assert [line.cells[track].text for track in DIGITS] == ["34.6", "3.9"]


def test_outdated_results_stand_apart(board):
    (late,) = {late.entry.metadata.name for late in board.outdated}
    assert late == "old"
    assert "old" not in column(rankings(board, "digits")["claimed"].whole, "afr")
    lines = group(board, "digits").outdated_sheet.lines
    assert [line.cells["track"].text for line in lines] == list(DIGITS)
    assert "version" in lines[0].cells["reason"].text


def test_the_strongest_attack_is_verified_and_has_the_highest_lower_bound(board):
    lines = {line.cells["track"].text: line.cells for line in board.strongest.lines}
    assert lines[DIGITS[0]]["entry"].text == HOSTILE
    assert lines[DIGITS[0]]["afr"].text == "89.0"  # of 90 % and 88 %
    assert lines[DIGITS[0]]["uniform_rate"].text == "34.6"
    assert lines[DIGITS[0]]["nominal"].text == "reads 98.9 % of the test images"
    racing = next(
        line.cells
        for line in board.strongest.lines
        if (line.cells["track"].text, line.cells["agent"].text) == (RACING[0], "ppo")
    )
    assert "entry" not in racing  # only claimed
    assert racing["uniform_rate"].text == "18.4"


def test_a_flagged_attack_is_not_the_strongest(tmp_path):
    made = (Made("copier", 0.96, flags=(("duplicates", FLAG),)), Made("honest", 0.6))
    board = make_board(read_entries(make_entries(tmp_path / "entries", made)), CARDS)
    assert column(rankings(board, "digits")["verified"].whole, "rank")["copier"] == "1"
    lines = {line.cells["track"].text: line.cells for line in board.strongest.lines}
    assert [lines[track]["entry"].text for track in DIGITS] == ["honest", "honest"]


def test_an_application_without_results_has_no_page_unless_a_suite_has_it(board):
    assert [page.card.page for page in board.groups] == ["racing", "digits"]


def test_the_front_is_what_no_other_ranked_entry_beats_twice(board):
    ranking = rankings(board, "digits")["verified"]
    chart = make_chart(ranking.rows, "AFR and coverage")
    figures = {
        row.entry: (row.afr.value, row.relative_coverage.value)
        for row in ranking.rows
        if not row.control
    }
    front = {point.row.entry for point in chart.points if point.front}
    for name, (afr, coverage) in figures.items():
        beaten = any(a > afr and c > coverage for a, c in figures.values())
        assert (name in front) == (not beaten)
    assert {point.row.entry for point in chart.points if point.row.control} == {"ideal"}
    assert all(0 < point.x < WIDTH and 0 < point.y < HEIGHT for point in chart.points)
    assert make_chart(ranking.rows[:1], "") is None


def test_an_entry_says_its_flags_in_words_once(board, entries, tmp_path):
    (middle, strong, newcomer) = (
        entry_page(
            board, next(e for e in entries if e.metadata.name == name), Pictures(False, tmp_path)
        )
        for name in ("middle", "strong", "newcomer")
    )
    (flag,) = middle.flags
    assert (flag.name, list(flag.texts), flag.count) == ("duplicates", [FLAG], 2)
    (note,) = strong.flags
    assert (note.name, list(note.texts), note.count) == ("", ["It stopped early."], 4)
    assert strong.links == {"Paper": "https://example.org/paper"}
    assert newcomer.links == {}
    (section,) = strong.sections
    assert section.sheet.lines[0].cells["seeds"].text == "90.0, 88.0"


@pytest.mark.parametrize(
    ("metadata", "by", "description"),
    [
        ({"authors": AUTHORS}, "the developers' baseline", "Samples mu uniformly"),
        ({"authors": AUTHORS, "description": "It."}, "the developers' baseline", "It."),
        ({"authors": ("Ada", "Grace")}, "Ada, Grace", ""),
    ],
)
def test_an_entry_says_whose_it_is_and_what_it_does(tmp_path, metadata, by, description):
    made = (Made("one", 0.5, adversary="random"),)
    (entry,) = read_entries(make_entries(tmp_path / "entries", made))
    entry = replace(entry, metadata=entry.metadata.model_copy(update=metadata))
    assert made_by(entry) == by
    assert describe(entry).startswith(description)
    assert bool(describe(entry)) is bool(description)


@pytest.mark.parametrize("url", ["javascript:alert(1)", "data:text/html,x", "//a.b", "", "ftp://a"])
def test_only_web_pages_are_linked(url):
    assert not is_web(url)
    assert is_web("https://example.org/a")


def test_files_hold_what_the_page_shows(board):
    sheet = rankings(board, "digits")["verified"].whole
    rows = list(csv.DictReader(io.StringIO(sheet.csv().decode())))
    records = json.loads(sheet.json())
    assert [row["kind"] for row in rows] == [line.kind for line in sheet.lines]
    for row, record, line in zip(rows, records, sheet.lines, strict=True):
        assert float(row["afr"]) == record["afr"] == line.cells["afr"].value
        if line.cells["afr"].interval:
            assert (record["afr_low"], record["afr_high"]) == line.cells["afr"].interval
    assert records[1]["entry"] == "=level"
    assert rows[1]["entry"] == "'=level"  # no formula


def test_a_sheet_without_rows_has_its_columns():
    sheet = Sheet("empty", "Empty", (Column("a", "A"), Column("b", "B")), ())
    assert sheet.csv() == b"kind,a,b\r\n"
    assert json.loads(sheet.json()) == []
    single = Sheet("one", "One", sheet.columns, (Line("ranked", {"a": text_cell("x")}),))
    assert json.loads(single.json()) == [{"kind": "ranked", "a": "x", "b": None}]
