"""The record of a diagnosis: where its rules hold, worlds drawn by them, and its file."""

import numpy as np
import pytest

from sada_gym import Parameter, ParameterSpace
from sada_gym.errors import FileError
from sada_gym.measures.diagnosis.record import (
    DIAGNOSIS_FILE,
    Condition,
    Diagnosis,
    Rate,
    Weakness,
    read_diagnosis,
    write_diagnosis,
)
from sada_gym.measures.diagnosis.rules import draw, holds, volume

AROUND = ("in front", "on the left", "behind", "on the right")
SPACE = ParameterSpace(
    Parameter("camera_azimuth_deg", -180.0, 180.0, "deg", directions=AROUND),
    Parameter("payload_kg", 0.0, 5.0, "kg"),
    Parameter("weather", 0.0, 3.0, choices=("sun", "rain", "fog")),
    Parameter("friction", 0.01, 1.0, log=True),
)


def condition(parameter, *ranges):
    return Condition(parameter=parameter, ranges=ranges, text=parameter)


BEHIND = condition("camera_azimuth_deg", (150.0, 210.0))
HEAVY = condition("payload_kg", (0.0, 1.0), (4.5, 5.0))
SLIPPERY = condition("friction", (0.01, 0.1))


@pytest.mark.parametrize(
    ("conditions", "share"),
    [
        ([], 1.0),
        ([BEHIND], 1 / 6),
        ([HEAVY], 0.3),
        ([condition("weather", (1.0, 3.0))], 2 / 3),
        ([SLIPPERY], 0.5),
        ([BEHIND, HEAVY, SLIPPERY], 0.025),
    ],
)
def test_worlds_drawn_from_a_rule_hold_it_and_fill_it(conditions, share):
    assert volume(conditions, SPACE) == pytest.approx(share)
    mu = draw(conditions, SPACE, 2_000, np.random.default_rng(0))
    assert holds(conditions, SPACE, mu).all()
    uniform = np.random.default_rng(1).uniform(-1, 1, (20_000, 4))
    inside = uniform[holds(conditions, SPACE, uniform)]
    assert len(inside) / len(uniform) == pytest.approx(share, abs=0.015)
    np.testing.assert_allclose(mu.mean(axis=0), inside.mean(axis=0), atol=0.12)
    np.testing.assert_allclose(mu.std(axis=0), inside.std(axis=0), atol=0.12)


def test_angles_count_all_around_and_the_last_value_of_a_range_belongs_to_it():
    mu = SPACE.normalised([[180.0, 5.0, 0.0, 1.0], [-180.0, 4.4, 0.0, 1.0], [149.0, 5.0, 0.0, 1.0]])
    assert holds([BEHIND], SPACE, mu).tolist() == [True, True, False]
    assert holds([HEAVY], SPACE, mu).tolist() == [True, False, True]


def diagnosis(**changes):
    rate = Rate.of(18, 20)
    weakness = Weakness(
        conditions=(HEAVY,),
        text="payload is below 1 kg or above 4.5 kg",
        volume=0.3,
        share=0.8,
        failures=80,
        distinct=3,
        inside=rate,
        outside=None,
        thresholds=(),
        examples=(),
    )
    return Diagnosis(
        sentence="One weakness.", weaknesses=(weakness,), worlds=900, failures=100, **changes
    )


def test_a_diagnosis_is_read_as_it_was_written(tmp_path):
    assert write_diagnosis(tmp_path, diagnosis()) == tmp_path / DIAGNOSIS_FILE
    assert read_diagnosis(tmp_path) == diagnosis()


def test_a_missing_and_another_versions_diagnosis_say_how_to_make_it(tmp_path):
    with pytest.raises(FileError, match=r"got no diagnosis\.json there\. Make it by `sada-gym"):
        read_diagnosis(tmp_path)
    write_diagnosis(tmp_path, diagnosis(version=7))
    with pytest.raises(FileError, match=r"of version 1 in .*, got version 7\. Make it again"):
        read_diagnosis(tmp_path)
    (tmp_path / DIAGNOSIS_FILE).write_text("{}")
    with pytest.raises(FileError, match=r"diagnosis\.json"):
        read_diagnosis(tmp_path)
