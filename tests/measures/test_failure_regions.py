"""The sentence on where an agent fails: what it finds, and that it finds nothing in noise."""

import numpy as np
import pytest

from sada_gym import Parameter, ParameterSpace, make_application
from sada_gym.errors import UserError
from sada_gym.measures.failure_regions import ALPHA, MIN_FAILURES, failure_regions

AROUND = ("in front", "on the left", "behind", "on the right")
WEATHERS = ("sun", "rain", "fog", "snow", "hail")
SPACE = ParameterSpace(
    Parameter("camera_azimuth_deg", -180.0, 180.0, "deg", directions=AROUND),
    Parameter("camera_pitch_deg", 0.0, 51.6, "deg"),
    Parameter("payload_kg", 0.0, 5.0, "kg"),
    Parameter("weather", 0.0, 5.0, choices=WEATHERS),
    Parameter("lanes", 1.5, 6.5, choices=("2", "3", "4", "5", "6")),
    Parameter("friction", 0.05, 0.45),
)


def worlds(n=200, seed=0, **within):
    """Draw uniform worlds, with some parameters in a range of physical values instead."""
    rng = np.random.default_rng(seed)
    values = SPACE.physical(rng.uniform(-1, 1, (n, len(SPACE))))
    for name, (low, high) in within.items():
        values[:, SPACE.names.index(name)] = rng.uniform(low, high, n)
    column = SPACE.names.index("camera_azimuth_deg")
    values[:, column] = (values[:, column] + 180) % 360 - 180
    return SPACE.normalised(values)


@pytest.mark.parametrize(
    ("within", "text"),
    [
        ({"camera_pitch_deg": (35, 51.6)}, "camera pitch is above 35°"),
        ({"camera_pitch_deg": (0, 10)}, "camera pitch is below 10°"),
        ({"payload_kg": (1.5, 3)}, "payload is between 1.5 kg and 3 kg"),
        ({"friction": (0.05, 0.13)}, "friction is below 0.14"),
        ({"weather": (2, 3)}, "weather is fog"),
        ({"weather": (3, 5)}, "weather is snow or hail"),
        ({"weather": (2, 5)}, "weather is not sun or rain"),
        ({"lanes": (3.5, 4.5)}, "lanes is 4"),
        ({"lanes": (1.5, 3.5)}, "lanes is at most 3"),
        ({"lanes": (4.5, 6.5)}, "lanes is at least 5"),
        ({"lanes": (2.5, 4.5)}, "lanes is 3 to 4"),
        ({"camera_azimuth_deg": (-45, 45)}, "camera is in front"),
        ({"camera_azimuth_deg": (135, 225)}, "camera is behind"),
        ({"camera_azimuth_deg": (0, 90)}, "camera is in front and on the left"),
        ({"camera_azimuth_deg": (-180, -90)}, "camera is behind and on the right"),
        ({"camera_azimuth_deg": (45, 225)}, "camera is on the left or behind"),
        ({"camera_azimuth_deg": (45, 315)}, "camera is not in front"),
    ],
)
def test_one_range_is_named_in_physical_units(within, text):
    regions = failure_regions(SPACE, worlds(**within))
    assert [condition.text for condition in regions.conditions] == [text]
    assert regions.share == 1.0
    assert regions.sentence.startswith(
        f"Fails always where {text}: 100 % of the 200 failures, against "
    )


def test_both_sides_of_a_ring_and_both_ends_of_a_range_are_found():
    sides = np.concatenate([worlds(camera_azimuth_deg=(a - 45, a + 45)) for a in (90, 270)])
    assert (
        failure_regions(SPACE, sides).conditions[0].text == "camera is on the left or on the right"
    )
    ends = np.concatenate([worlds(payload_kg=(0, 0.5)), worlds(payload_kg=(4.5, 5), seed=1)])
    [both] = failure_regions(SPACE, ends).conditions
    assert both.text == "payload is below 0.5 kg or above 4.5 kg"
    assert both.ranges == ((0.0, 0.5), (4.5, 5.0))


def test_conditions_are_joined_with_their_shares_counted():
    inside = worlds(300, camera_pitch_deg=(35, 51.6), camera_azimuth_deg=(135, 225))
    regions = failure_regions(SPACE, np.concatenate([inside, worlds(60, seed=1)]))
    assert {condition.parameter for condition in regions.conditions} == {
        "camera_pitch_deg",
        "camera_azimuth_deg",
    }
    values = SPACE.physical(np.concatenate([inside, worlds(60, seed=1)]))
    share = np.mean((values[:, 1] >= 35) & (np.abs(values[:, 0]) >= 135))
    assert regions.share == pytest.approx(share)
    assert regions.uniform == pytest.approx(16.6 / 51.6 / 4)
    assert regions.sentence == (
        "Fails mostly where camera is behind and camera pitch is above 35°: "
        f"{100 * share:.0f} % of the 360 failures, against 8 % of uniform worlds."
    )


def test_a_range_is_named_only_if_it_holds_more_by_a_clear_margin():
    weak = np.concatenate([worlds(3_000), worlds(300, seed=1, payload_kg=(0, 2.5))])
    assert failure_regions(SPACE, weak).conditions == ()
    assert "Nowhere in particular" in failure_regions(SPACE, weak).sentence
    stronger = np.concatenate([worlds(300), worlds(200, seed=1, payload_kg=(0, 1.5))])
    regions = failure_regions(SPACE, stronger)
    assert regions.sentence.startswith("Fails more often where payload is below 1.5 kg: 5")
    assert regions.uniform == pytest.approx(0.3)


@pytest.mark.parametrize("n", [MIN_FAILURES, 15, 40, 250, 2_000])
@pytest.mark.parametrize("dimension", [1, 6, 60])
def test_uniform_failures_stand_out_nowhere(n, dimension):
    space = SPACE if dimension == 6 else ParameterSpace(
        *(Parameter(f"x{i}", -1.0, 1.0) for i in range(dimension))
    )  # fmt: skip
    rng = np.random.default_rng([n, dimension])
    tries = 40 if dimension == 60 else 150
    claims = sum(
        bool(failure_regions(space, rng.uniform(-1, 1, (n, len(space)))).conditions)
        for _ in range(tries)
    )
    assert claims <= 1 + ALPHA * tries


def test_few_failures_are_enough_where_they_crowd_and_too_few_else():
    crowd = worlds(MIN_FAILURES, camera_pitch_deg=(40, 45), payload_kg=(0, 0.5))
    assert failure_regions(SPACE, crowd).conditions
    expected = "Only 4 samples fooled the agent, too few to say where it fails."
    assert failure_regions(SPACE, worlds(4)).sentence == expected
    assert failure_regions(SPACE, worlds(1)).sentence.startswith("Only one sample fooled")
    assert failure_regions(SPACE, worlds(0)).sentence == "No sample fooled the agent."


def test_repeated_worlds_count_once():
    regions = failure_regions(SPACE, np.repeat(worlds(3), 80, axis=0))
    assert regions.sentence == (
        "The 240 failures are 3 different worlds, too few to say where the agent fails."
    )
    assert regions.conditions == ()
    assert "are one world" in failure_regions(SPACE, np.repeat(worlds(1), 50, axis=0)).sentence


def test_samples_on_the_border_count():
    border = worlds(camera_pitch_deg=(51.6, 51.6), camera_azimuth_deg=(180, 180))
    regions = failure_regions(SPACE, border)
    assert [condition.text for condition in regions.conditions[:2]] == [
        "camera pitch is above 50°",
        "camera is behind",
    ]
    assert regions.share == 1.0


def test_a_small_share_of_uniform_worlds_is_not_zero():
    regions = failure_regions(
        SPACE, worlds(camera_pitch_deg=(50, 51.6), payload_kg=(0, 0.5), friction=(0.05, 0.07))
    )
    assert regions.sentence.endswith("against under 0.1 % of uniform worlds.")
    assert 0 < regions.uniform < 0.001


def test_units_and_signs_are_written_as_people_write_them():
    space = ParameterSpace(Parameter("rotation_deg", -35.0, 35.0, "deg"))
    mu = space.normalised(np.linspace(-35, -20, 50)[:, None])
    assert failure_regions(space, mu).conditions[0].text == "rotation is below \N{MINUS SIGN}20°"


@pytest.mark.parametrize("low_high", [(0.0, 1e-9), (-1e12, 1e12), (3.0, 3.1), (-7.0, 0.013)])
def test_any_range_has_round_ends(low_high):
    space = ParameterSpace(Parameter("x", *low_high))
    rng = np.random.default_rng(0)
    regions = failure_regions(space, rng.uniform(-1, -0.5, (50, 1)))
    assert regions.share == 1.0
    assert 0.2 < regions.uniform < 0.4
    digits = regions.conditions[0].text.split("below ")[1].lstrip("\N{MINUS SIGN}")
    assert len(digits.partition("e")[0].replace(".", "").strip("0")) <= 4


def test_a_narrow_range_far_from_zero_keeps_its_digits():
    space = ParameterSpace(Parameter("x", 1e8, 1e8 + 100))
    mu = space.normalised(np.linspace(1e8, 1e8 + 29, 50)[:, None])
    assert failure_regions(space, mu).conditions[0].text == "x is below 100000030"


def test_a_single_choice_is_no_condition():
    space = ParameterSpace(Parameter("only", 0.0, 1.0, choices=("this",)), Parameter("x", 0.0, 1.0))
    mu = np.random.default_rng(0).uniform(-1, [1, -0.5], (50, 2))
    assert [condition.parameter for condition in failure_regions(space, mu).conditions] == ["x"]


def test_a_thousand_choices_in_order_are_ranges():
    space = ParameterSpace(Parameter("n", 0.0, 1000.0, choices=tuple(map(str, range(1000)))))
    for low, high, text in ((0, 240, "at most 239"), (760, 1000, "at least 760")):
        mu = space.normalised(np.linspace(low + 0.5, high - 0.5, 200)[:, None])
        assert failure_regions(space, mu).conditions[0].text == f"n is {text}"


def test_a_name_of_several_lines_is_refused():
    with pytest.raises(UserError, match="name in one line"):
        ParameterSpace(Parameter("wind\nspeed_m_s", 0.0, 1.0, "m/s"))


def test_the_order_of_failures_does_not_matter():
    mu = np.concatenate([worlds(90, weather=(0, 1)), worlds(30, seed=1)])
    assert failure_regions(SPACE, mu) == failure_regions(SPACE, mu[::-1])


def test_detection_says_where_camera_and_light_are():
    parameters = make_application("SADA-Detection-Car-v0").parameters.parameters
    around = [parameter.name for parameter in parameters if parameter.directions]
    assert around == ["camera_azimuth_deg", "light_azimuth_deg"]


@pytest.mark.parametrize(
    ("low", "high", "directions"),
    [(-180, 180, AROUND[:3]), (0, 90, AROUND), (-180, 180, (*AROUND, "above"))],
)
def test_directions_are_of_a_whole_turn(low, high, directions):
    with pytest.raises(ValueError, match="Expected four directions of an angle over 360 degrees"):
        Parameter("azimuth_deg", low, high, "deg", directions=directions)


LOG = ParameterSpace(
    Parameter("damping", 1e-4, 1.0, log=True),
    Parameter("gravity", -20.0, -2.0, "m/s2", log=True),
    Parameter("cars", 4.5, 35.5, whole=True),
    Parameter("batch", 0.5, 1000.5, log=True, whole=True),
)


@pytest.mark.parametrize(
    ("name", "within", "text"),
    [
        ("damping", (-1.0, -0.5), "damping is below 0.001"),
        ("gravity", (0.4, 1.0), "gravity is above \N{MINUS SIGN}4 m/s2"),
        ("cars", (-1.0, -0.033), "cars is at most 19"),
        ("cars", (0.5, 1.0), "cars is at least 28"),
        ("batch", (0.4, 1.0), "batch is at least 100"),
    ],
)
def test_logarithmic_and_whole_parameters_have_edges_of_their_own(name, within, text):
    mu = np.random.default_rng(0).uniform(-1, 1, (400, len(LOG)))
    mu[:, LOG.names.index(name)] = np.random.default_rng(1).uniform(*within, 400)
    found = failure_regions(LOG, mu)
    assert [condition.text for condition in found.conditions] == [text]
    assert found.uniform == pytest.approx((within[1] - within[0]) / 2, abs=0.03)
