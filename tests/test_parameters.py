"""Parameters: the box, its physical values, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sada_gym.parameters import Parameter, ParameterSpace, validate_mu


@pytest.fixture
def space() -> ParameterSpace:
    return ParameterSpace(
        Parameter("azimuth_deg", -180, 180, "deg"), Parameter("distance_m", 2, 6, "m")
    )


def test_a_space_knows_its_names_and_dimension(space: ParameterSpace) -> None:
    assert len(space) == 2
    assert [parameter.name for parameter in space] == [*space.names]
    assert space.names == ("azimuth_deg", "distance_m")


def test_the_corners_and_the_middle_map_to_the_range(space: ParameterSpace) -> None:
    physical = space.physical([[-1, -1], [0, 0], [1, 1]])
    assert physical.dtype == np.float64
    assert_array_equal(physical, [[-180, 2], [0, 4], [180, 6]])


def test_normalised_inverts_physical(space: ParameterSpace) -> None:
    mu = np.random.default_rng(0).uniform(-1, 1, (100, 2)).astype(np.float32)
    back = space.normalised(space.physical(mu))
    assert back.dtype == np.float32
    assert_array_equal(back, mu)


def test_normalised_takes_one_point(space: ParameterSpace) -> None:
    assert_allclose(space.normalised([90, 3]), [0.5, -0.5])


def test_describe_names_python_floats(space: ParameterSpace) -> None:
    described = space.describe(np.zeros(2, dtype=np.float32))
    assert described == {"azimuth_deg": 0.0, "distance_m": 4.0}
    assert all(type(value) is float for value in described.values())


def test_float64_is_rounded_before_it_is_mapped(space: ParameterSpace) -> None:
    assert_array_equal(space.physical([0.1, 0.1]), space.physical(np.float32([0.1, 0.1])))


def test_validate_gives_contiguous_float32(space: ParameterSpace) -> None:
    mu = space.validate(np.asfortranarray(np.zeros((3, 2))))
    assert mu.dtype == np.float32
    assert mu.flags.c_contiguous


def test_a_mask_is_refused_wherever_values_are_mapped(space: ParameterSpace) -> None:
    for change in (space.physical, space.normalised, space.describe):
        with pytest.raises(ValueError, match="without a mask, got a masked array"):
            change(np.ma.zeros(2))


def test_validate_takes_an_empty_batch_and_the_faces(space: ParameterSpace) -> None:
    assert space.validate(np.zeros((0, 2))).shape == (0, 2)
    assert_array_equal(space.validate([[-1, 1]]), [[-1, 1]])


@pytest.mark.parametrize(
    ("mu", "message"),
    [
        ([0.0, 0.0], r"Expected mu of shape \(n, 2\), got \(2,\). Pass mu\[None\] for a single"),
        ([[0.0]], r"Expected mu of shape \(n, 2\), got \(1, 1\)"),
        (np.zeros((1, 1, 2)), r"Expected mu of shape \(n, 2\), got \(1, 1, 2\)"),
        ([[0, 0], [0, np.nan]], r"within \[-1, 1\], got nan at row 1, column 1. Clip or rescale"),
        ([[1.5, 0]], r"within \[-1, 1\], got 1.5 at row 0, column 0"),
        ([[0, -np.inf]], r"within \[-1, 1\], got -inf at row 0, column 1"),
        ([[0, 1e300]], r"within \[-1, 1\], got inf at row 0, column 1"),
        (np.zeros((1, 2), complex), "an array of real numbers, got dtype complex128. Convert it"),
        ([["0", "0"]], "an array of real numbers, got dtype <U1"),
        ([[b"0", b"0"]], "an array of real numbers, got dtype "),
        ([[None, 0]], "an array of real numbers, got dtype object"),
        (np.ones((1, 2), bool), "an array of real numbers, got dtype bool"),
        ([[0, 0], [0]], "an array of real numbers, got: setting an array element"),
        (np.ma.zeros((1, 2)), r"Expected mu without a mask, .* mu.filled\(value\)"),
        ([np.ma.zeros(2), np.zeros(2)], "Expected mu without a mask"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_bad_mu_is_refused(mu: np.typing.ArrayLike, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        validate_mu(mu, 2)


@pytest.mark.parametrize(("low", "high"), [(1, 1), (2, 1), (np.nan, 1), (0, np.inf)])
def test_an_empty_range_is_refused(low: float, high: float) -> None:
    with pytest.raises(ValueError, match="Expected finite low < high for parameter 'a'"):
        Parameter("a", low, high)


@pytest.mark.parametrize("end", ["0", None, 1j])
def test_a_range_of_anything_but_numbers_is_refused(end: object) -> None:
    with pytest.raises(ValueError, match="Expected finite low < high for parameter 'a', got low="):
        Parameter("a", end, 1)  # type: ignore[arg-type]


def test_a_range_wider_than_floats_is_refused() -> None:
    with pytest.raises(ValueError, match="Expected finite low < high"):
        Parameter("a", -1e308, 1e308)


@pytest.mark.parametrize("name", ["", 3, None])
def test_a_name_that_is_no_text_is_refused(name: object) -> None:
    with pytest.raises(TypeError, match="Expected a parameter's name to be a text, got"):
        Parameter(name, 0, 1)  # type: ignore[arg-type]


@pytest.mark.parametrize("given", ["a", [Parameter("a", 0, 1)]])
def test_a_space_of_anything_but_parameters_is_refused(given: object) -> None:
    with pytest.raises(TypeError, match="Expected Parameter objects, one after another, got"):
        ParameterSpace(given)  # type: ignore[arg-type]


def test_a_space_without_parameters_is_refused() -> None:
    with pytest.raises(ValueError, match="Expected at least one Parameter, got none"):
        ParameterSpace()


def test_doubled_names_are_refused() -> None:
    with pytest.raises(ValueError, match=r"Expected distinct parameter names, got \['a', 'a'\]"):
        ParameterSpace(Parameter("a", 0, 1), Parameter("a", 0, 2))


@pytest.mark.parametrize(
    ("parameter", "value", "text"),
    [
        (Parameter("camera_pitch_deg", -90, 90, "deg"), -12.34, "camera pitch \N{MINUS SIGN}12.3°"),
        (Parameter("wind_speed_m_s", 0, 9, "m/s"), 3.0, "wind speed 3 m/s"),
        (Parameter("offset_m", -0.15, 0.15, "m"), 8.44e-5, "offset 0.0001 m"),
        (Parameter("yaw_deg", -180, 180, "deg"), -0.02, "yaw 0°"),
        (Parameter("offset_m", -15, -5, "m"), -10.448, "offset \N{MINUS SIGN}10.4 m"),
        (Parameter("rate", 1e-6, 1.0, log=True), 8.44e-5, "rate 8.44e\N{MINUS SIGN}05"),
        (Parameter("density", 0, 2, "1/m²"), 1.5, "density 1.5 per m²"),
        (Parameter("mass", 0, 5000), 4321.0, "mass 4,321"),
        (Parameter("light", 0, 2, choices=("low", "high")), 2.0, "light high"),
    ],
)
def test_values_in_words(parameter: Parameter, value: float, text: str) -> None:
    assert parameter.text(value) == text


@pytest.mark.parametrize(("low", "high"), [(1e-3, 1e3), (-10.0, -0.1), (1e-300, 1e300), (2, 3)])
def test_a_logarithmic_parameter_is_even_in_its_logarithm(low, high):
    space = ParameterSpace(Parameter("x", low, high, log=True), Parameter("y", 0.0, 1.0))
    mu = np.random.default_rng(0).uniform(-1, 1, (100, 2)).astype(np.float32)
    mu[:3, 0] = [-1, 0, 1]
    values = space.physical(mu)
    assert [*values[[0, 2], 0]] == [low, high]
    assert_allclose(np.log(abs(values[1, 0])), np.log([abs(low), abs(high)]).mean(), atol=1e-9)
    assert_array_equal(values[:, 1], ParameterSpace(space.parameters[1]).physical(mu[:, 1:])[:, 0])
    assert_allclose(space.normalised(values), mu, atol=1e-6)


def test_beyond_zero_a_logarithm_is_infinitely_far():
    assert_array_equal(Parameter("x", 0.1, 1.0, log=True).shares([0.0, -5.0]), -np.inf)
    assert_array_equal(Parameter("x", -1.0, -0.1, log=True).shares([0.0, 5.0]), np.inf)


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-1.0, 1.0), (-1.0, 0.0)])
def test_a_logarithm_needs_one_sign(low, high):
    with pytest.raises(ValueError, match=r"low and high of one sign, and not 0, .* 'x'"):
        Parameter("x", low, high, log=True)


@pytest.mark.parametrize(
    ("parameter", "values"),
    [
        (Parameter("x", 1e-3, 1e3, log=True), [0.01, 0.1, 1, 10, 100]),
        (Parameter("x", -10, -0.1, log=True), [-5, -2, -1, -0.5, -0.2]),
        (Parameter("x", 1, 2, log=True), [1.2, 1.4, 1.6, 1.8]),
        (Parameter("x", -1, 1), [-0.5, 0, 0.5]),
    ],
)
def test_round_values_lie_inside(parameter, values):
    assert_allclose(parameter.round_values(5), values, atol=1e-12)


def test_whole_numbers_are_said_as_such():
    cars = Parameter("cars", 4.5, 35.5, whole=True)
    assert [cars.text(x) for x in (4.5, 20.4, 35.5)] == ["cars 5", "cars 20", "cars 35"]
