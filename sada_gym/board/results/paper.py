"""The attack fooling rates that the paper reports, for other agents and other worlds than ours.

They are from Table 1 and from the appendix's table of detectors in Hamdi, Mueller & Ghanem 2020, as
printed there; where the two contradict each other, so do these.
"""

from __future__ import annotations

from collections.abc import Mapping

AVERAGE = "12-class avg"
FULL_SET = "full set"

Rates = Mapping[str, float]
"""AFR in percent by track, and by `AVERAGE` that of the twelve classes."""

_CLASSES = (
    *("Aeroplane", "Bench", "Bicycle", "Boat", "Bottle", "Bus", "Car", "Chair", "DiningTable"),
    *("Motorbike", "Train", "Truck"),
)
CLASS_COLUMNS = {name.lower(): f"SADA-Detection-{name}-v0" for name in _CLASSES}
"""The classes of the appendix's table and our tracks."""

TABLE_1_COLUMNS: dict[str, str | None] = {
    **{name: f"SADA-Detection-{name}-v0" for name in ("Bicycle", "Motorbike", "Truck")},
    AVERAGE: None,
    "Straight": "SADA-Driving-Straight-v0",
    "One Curve": "SADA-Driving-OneCurve-v0",
    "Navigation": "SADA-Driving-Navigation-v0",
    **{f"{count} anchors": f"SADA-UAV-{count}Anchors-v0" for count in (3, 4, 5)},
}
"""The columns of the paper's Table 1 and our tracks; the average's are the twelve classes."""

_TABLE_1 = """\
Full Set: 14.6 32.5 56.8 37.1 10.6 19.5 46.3 17.0 23.5 15.8
Random: 13.3 38.8 73.8 45.7 8.0 18.0 48.0 22.0 30.0 16.0
Multi-Class SVM: 20.0 45.6 70.8 45.8 96.0 100.0 100.0 24.0 30.0 14.0
GP Regression: 17.6 43.6 83.6 45.26 100.0 100.0 100.0 74.0 94.0 44.0
Gaussian: 19.6 40.4 72.4 47.0 54.0 30.0 64.0 49.3 56.0 28.7
GMM10%: 26.0 48.4 75.2 49.0 90.0 72.0 98.0 57.0 63.0 33.0
GMM50%: 16.4 46.8 72.0 47.8 92.0 68.0 100.0 54.0 60.0 40.0
Bayesian: 48.0 52.0 75.6 56.1 - - - - - -
BBGAN (vanilla): 44.0 45.2 90.8 74.5 100.0 98.0 98.0 42.0 94.0 86.0
BBGAN (boost): 65.8 82.0 100.0 80.5 100.0 100.0 100.0 86.0 98.0 92.0
"""

_APPENDIX = """\
Full Set: 8.64 35.2 14.6 33.4 22.5 53.1 39.8 44.1 46.1 32.5 58.1 56.8 37.1 0.577
Random: 11.3 42.7 18.6 41.8 28.4 65.7 49.9 55.3 56.4 40.3 72.8 70.8 46.2 0.584
Multi-Class SVM: 12.0 45.6 20.0 39.6 26.0 64.4 49.6 50.4 53.6 45.6 72.0 70.8 45.8 0.576
GP Regression: 13.6 15.6 17.6 41.2 31.6 71.6 51.6 48.0 56.0 43.6 69.2 83.6 45.26 0.492
Gaussian: 11.2 45.6 19.6 41.6 31.2 70.4 48.0 56.8 55.6 40.4 71.2 72.4 47.0 0.548
GMM10%: 14.8 45.2 26.0 42.8 34.0 67.2 53.2 56.4 54.8 48.4 70.4 75.2 49.0 0.567
GMM50%: 12.0 44.0 16.4 46.4 33.2 66.4 51.6 53.2 58.4 46.8 73.6 72.0 47.8 0.573
Bayesian: 9.2 42.0 48.0 68.8 32.4 91.6 42.0 75.6 58.4 52.0 77.2 75.6 56.1 0.540
BBGAN (vanilla): 13.2 91.6 44.0 90.0 54.4 91.6 81.6 93.2 99.2 45.2 99.2 90.8 74.5 0.119
BBGAN (boost): 33.0 82.4 65.8 78.8 67.4 100.0 67.4 100.0 90.2 82.0 98.4 100.0 80.5 0.100
"""


def _parse(printed: str, *columns: str) -> dict[str, Rates]:
    """Read a row a line: its name, then a number or a dash for each column."""
    rows = (line.partition(": ") for line in printed.splitlines())
    return {
        name: {
            column: float(number)
            for column, number in zip(columns, numbers.split(), strict=True)
            if number != "-"
        }
        for name, _, numbers in rows
    }


TABLE_1 = _parse(_TABLE_1, *(track or AVERAGE for track in TABLE_1_COLUMNS.values()))
"""The rows of the paper's Table 1, without the rates that are a dash there."""

CLASS_TABLE = _parse(_APPENDIX, *CLASS_COLUMNS.values(), AVERAGE, "mu_std")
"""The rows of the table in the paper's appendix; `mu_std` is the spread of the samples."""

ROWS: dict[str, str] = {
    FULL_SET: "Full Set",
    "random": "Random",
    "svm": "Multi-Class SVM",
    "gp": "GP Regression",
    "gaussian": "Gaussian",
    "gmm10": "GMM10%",
    "gmm50": "GMM50%",
    "bayesian": "Bayesian",
    "bbgan": "BBGAN (vanilla)",
    "bbgan (paper)": "BBGAN (vanilla)",
    "bbgan-boost": "BBGAN (boost)",
    "bbgan-boost (paper)": "BBGAN (boost)",
}
"""The paper's row that each adversary of ours is compared with, by the adversary's label."""


def rates_of(table: Mapping[str, Rates], key: str) -> Mapping[str, float]:
    """Return a column of `TABLE_1` or `CLASS_TABLE` by adversary label; empty if missing."""
    return {label: table[row][key] for label, row in ROWS.items() if key in table[row]}
