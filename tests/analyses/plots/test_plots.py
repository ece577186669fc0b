import os
import subprocess
import sys
from importlib.util import find_spec

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image
from toy import Blind, Toy

from sada_gym.analyses.plots.attack import (
    MAX_PARAMETERS,
    axis_label,
    contact_sheet,
    draw_attack,
    marginals,
    scatter,
    score_histogram,
)
from sada_gym.analyses.plots.sphere import sphere, spheres_of
from sada_gym.analyses.plots.style import png
from sada_gym.board.results.charts import (
    NOVELTY_PANELS,
    Curve,
    anytime_curves,
    marginal_strips,
    novelty_ratios,
)
from sada_gym.foundations.frames import LegendEntry
from sada_gym.oracle import Evaluations
from sada_gym.parameters import Parameter, ParameterSpace

PNG = b"\x89PNG\r\n\x1a\n"


def drawn(n, dimension=3, seed=0):
    rng = np.random.default_rng(seed)
    mu = rng.uniform(-1, 1, (n, dimension)).astype(np.float32)
    return Evaluations(mu, rng.random(n), rng.integers(2**31, size=n))


def test_all_pictures(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)  # importing it would raise
    names = [path.name for path in draw_attack(Toy(), drawn(50), drawn(200), tmp_path)]
    assert names == ["marginals.png", "scores.png", "influence.png", "fooled.png"]
    for name in names:
        assert (tmp_path / name).read_bytes().startswith(PNG)


def test_samples_lie_on_the_sphere_around_the_object():
    around = ("in front", "on the left", "behind", "on the right")
    space = ParameterSpace(
        Parameter("camera_azimuth_deg", -180.0, 180.0, "deg", directions=around),
        Parameter("size_m", 0.0, 1.0, "m"),
        Parameter("camera_pitch_deg", -20.0, 90.0, "deg"),
        Parameter("wind_azimuth_deg", -180.0, 180.0, "deg", directions=around),
    )
    assert spheres_of(space) == [(0, 2)]
    samples = Evaluations(
        np.array([[0, 0, 1, 0], [0.5, 0, -1, 0]], np.float32), np.array([0.1, 0.9]), np.arange(2)
    )
    (axes,) = sphere(space, samples, 0.3).axes
    passed, fooled = (one.get_offsets() for one in axes.collections)
    np.testing.assert_allclose(fooled, [[0.0, 0.0]], atol=1e-6)  # the zenith is in the middle
    np.testing.assert_allclose(passed, [[np.pi / 2, axes.get_rmax()]], rtol=1e-6)


ODD_STYLE = {
    "text.usetex": True,
    "font.family": "a font that is not there",
    "savefig.dpi": 7,
    "savefig.bbox": "tight",
    "axes.formatter.use_locale": True,
    "axes.facecolor": "black",
    "text.color": "white",
    "lines.linewidth": 9,
}


def every_figure(folder):
    """All kinds of figures as the bytes of their files, by name."""
    frames = [np.full((24, 32, 3), shade, np.uint8) for shade in (0, 128)]
    space = ParameterSpace(Parameter("x", 0.0, 1.0), Parameter("y_m", -1.0, 1.0, "m"))
    curve = Curve(("random",), np.array([10.0, 90.0]), np.array([1.0, 5.0]), None)
    folder.mkdir()
    draw_attack(Toy(2), drawn(30, 2), drawn(90, 2), folder)
    return {path.name: path.read_bytes() for path in folder.iterdir()} | {
        "contact": png(contact_sheet(frames, ["a", "b"], "title")),
        "curves": png(anytime_curves([curve], "title")),
        "strips": png(marginal_strips(space, {"random": drawn(30, 2).mu}, None, "title")),
        "ratios": png(novelty_ratios({"random": {k: [0.5] for k in NOVELTY_PANELS}}, "title")),
    }


def test_a_users_style_changes_no_figure_of_ours(tmp_path):
    plain = every_figure(tmp_path / "plain")
    with mpl.rc_context(ODD_STYLE):
        odd = every_figure(tmp_path / "odd")
        assert {key: mpl.rcParams[key] for key in ("text.usetex", "savefig.dpi")} == {
            "text.usetex": True,
            "savefig.dpi": 7,
        }
    assert [name for name in plain if odd[name] != plain[name]] == []


INLINE = "module://matplotlib_inline.backend_inline"
"""The backend of notebooks, which matplotlib refuses where its package is not installed."""


@pytest.mark.parametrize(
    ("named", "left"),
    [
        ("pdf", "pdf"),
        ("module://matplotlib.backends.backend_svg", "module://matplotlib.backends.backend_svg"),
        (INLINE, INLINE if find_spec("matplotlib_inline") else "None"),
        ("not-installed", "None"),
    ],
)
def test_a_users_backend_is_left_alone(named, left):
    program = (
        "import os, sys\n"
        "from sada_gym.foundations.drawing import own_style\n"
        "from sada_gym.analyses.plots.style import new_figure, png\n"
        "with own_style():\n"
        "    figure = new_figure(2, 2)\n"
        "    figure.subplots()\n"
        "assert png(figure).startswith(b'\\x89PNG')\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
        "import matplotlib as mpl\n"
        "print(os.environ['MPLBACKEND'], mpl.get_backend(auto_select=False))\n"
    )
    environment = {**os.environ, "MPLBACKEND": named}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert (done.stdout.split(), done.stderr) == ([named, left], "")


def test_the_same_data_give_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        draw_attack(Toy(2), drawn(30, 2), drawn(90, 2), tmp_path / name)
    for picture in (tmp_path / "a").iterdir():
        assert picture.read_bytes() == (tmp_path / "b" / picture.name).read_bytes()


@pytest.mark.parametrize("dimension", [1, 5])
def test_any_dimension(dimension, tmp_path):
    pictures = draw_attack(Toy(dimension), drawn(20, dimension), drawn(0, dimension), tmp_path)
    assert ("map.png" in {path.name for path in pictures}) == (dimension == 2)


def test_no_contact_sheet_without_frames_or_fooled_samples(tmp_path):
    unhurt = drawn(20)
    unhurt.score[:] = 1.0
    with pytest.warns(UserWarning, match="No frames are drawn. Blind draws no pictures"):
        blind = draw_attack(Blind(), drawn(20), drawn(9), tmp_path)
    for pictures in (blind, draw_attack(Toy(), unhurt, drawn(9), tmp_path)):
        assert {path.name for path in pictures} == {"marginals.png", "scores.png"}


def test_dollars_in_names_are_no_formulae(tmp_path):
    odd = Toy(2)
    odd.parameters = ParameterSpace(
        Parameter(r"price$\frac{$", 0.0, 1.0, r"$\us$"),
        Parameter("coin", 0.0, 2.0, choices=(r"$\half$", "$")),
    )
    assert len(draw_attack(odd, drawn(20, 2), drawn(9, 2), tmp_path)) == 4


@pytest.mark.parametrize(
    "legend",
    [True, ("text",), (LegendEntry("x", "red"),), (LegendEntry("x", mark="star"),)],
)
def test_a_legend_of_another_kind_costs_no_result(legend, tmp_path):
    odd = type("Odd", (Toy,), {"legend": legend})()
    with pytest.warns(UserWarning, match=r"No frames are drawn: .*Odd\.legend"):
        names = {path.name for path in draw_attack(odd, drawn(20), drawn(9), tmp_path)}
    assert names == {"marginals.png", "scores.png"}


class Batched(Toy):
    """It notes the batches that it draws."""

    def __init__(self, *arguments, **keywords):
        super().__init__(*arguments, **keywords)
        self.batches = []

    def render_batch(self, mu, seeds):
        self.batches.append(len(mu))
        return super().render_batch(mu, seeds)

    def evaluate_batch(self, mu, seeds):
        raise AssertionError("a picture evaluated a sample again")


def test_failures_are_drawn_in_one_batch_after_the_first_and_evaluated_never(tmp_path):
    application, progress = Batched(2), []
    draw_attack(
        application, drawn(90, 2), drawn(9, 2), tmp_path, on_progress=lambda *n: progress.append(n)
    )
    assert application.batches == [1, 8]
    assert progress == [(done, 9) for done in range(1, 10)]


def test_a_headline_stands_on_top(tmp_path):
    heights = []
    for headline in ("", "Half of the samples fool the agent."):
        draw_attack(Toy(), drawn(50), drawn(9), tmp_path, headline=headline)
        heights.append(Image.open(tmp_path / "fooled.png").height)
    assert heights[0] < heights[1]


class Declared(Toy):
    legend = (LegendEntry("the angle", "#ff00ff", "disc"),)


@pytest.mark.parametrize(("application", "shown"), [(Toy(), False), (Declared(), True)])
def test_the_legend_is_what_the_application_declares(application, shown, tmp_path):
    draw_attack(application, drawn(50), drawn(9), tmp_path)
    pixels = np.asarray(Image.open(tmp_path / "fooled.png").convert("RGB"))
    assert (pixels == (255, 0, 255)).all(axis=-1).any() == shown


class Odd(Toy):
    """It draws what is no frame, or fails."""

    def __init__(self, frame):
        super().__init__()
        self.frame = frame

    def render(self, mu, seed):
        if self.frame is None:
            raise RuntimeError("no window")
        return self.frame


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (None, "No frames are drawn: Odd.render raised RuntimeError: no window"),
        (np.zeros(8), r"Expected a frame .*of shape \(8,\) and type float64. Fix Odd.render"),
        (np.zeros((8, 8, 5), np.uint8), r"of shape \(8, 8, 5\) and type uint8"),
        (np.zeros((0, 8, 3), np.uint8), r"of shape \(0, 8, 3\)"),
        ("a frame", "Expected a frame"),
    ],
)
def test_a_bad_frame_costs_no_other_picture(frame, message, tmp_path):
    with pytest.warns(UserWarning, match=message):
        pictures = draw_attack(Odd(frame), drawn(50), drawn(9), tmp_path)
    assert [path.name for path in pictures] == ["marginals.png", "scores.png"]


def test_an_error_of_the_caller_is_the_callers(tmp_path):
    def stop(done, total):
        raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        draw_attack(Toy(), drawn(50), drawn(9), tmp_path, on_progress=stop)


def test_of_many_parameters_the_least_uniform_are_drawn():
    samples = drawn(60, 40)
    samples.mu[:, 17] = 0.9
    figure = marginals(Toy(40).parameters, samples, 0.3)
    labels = [axes.get_xlabel() for axes in figure.axes if axes.get_visible()]
    assert len(labels) == MAX_PARAMETERS
    assert "angle17 (°)" in labels


def test_marginals_show_physical_units_and_shares():
    space = ParameterSpace(Parameter("height_m", 2.0, 4.0, "m"))
    samples = drawn(40, 1)
    axes = marginals(space, samples, 0.3).axes[0]
    assert axes.get_xlim() == (2.0, 4.0)
    assert axes.get_xlabel() == "height (m)"
    tops = {}
    for bar in axes.patches:
        tops[bar.get_x()] = max(tops.get(bar.get_x(), 0.0), bar.get_y() + bar.get_height())
    assert sum(tops.values()) == pytest.approx(100.0)


def test_the_histogram_takes_scores_beyond_one():
    samples = drawn(10)
    samples.score[0] = 3.0
    assert score_histogram(samples, drawn(0), 0.3).axes[0].get_xlim() == (0.0, 3.0)


def test_a_contact_sheet_of_one():
    sheet = contact_sheet([np.zeros((4, 4, 3), np.uint8)], ["Q = 0.10"], "one")
    assert sheet.axes[0].get_title() == "Q = 0.10"


@pytest.mark.parametrize(
    ("parameter", "label"),
    [
        (Parameter("camera_azimuth_deg", 0, 1, "deg"), "camera azimuth (°)"),
        (Parameter("colour_red", 0, 1), "colour red"),
        (Parameter("distance", 0, 1, "m"), "distance (m)"),
    ],
)
def test_labels(parameter, label):
    assert axis_label(parameter) == label


def test_choices_and_whole_numbers_are_bars_and_logarithms_even():
    space = ParameterSpace(
        Parameter("weather", 0.0, 3.0, choices=("sun", "rain", "hail")),
        Parameter("cars", 4.5, 24.5, whole=True),
        Parameter("friction", 0.01, 10.0, log=True),
    )
    weather, cars, friction = marginals(space, drawn(400, 3), 0.3).axes[:3]
    assert [tick.get_text() for tick in weather.get_xticklabels()] == ["sun", "rain", "hail"]
    middles = {round(bar.get_x() + bar.get_width() / 2, 6) for bar in cars.patches}
    assert middles == set(range(5, 25))
    assert all(bar.get_width() < 1.0 for bar in cars.patches)
    ticks = {tick.get_text(): tick.get_position()[0] for tick in friction.get_xticklabels()}
    assert ticks["0.1"] == pytest.approx(1 / 3)
    assert friction.get_xlim() == (0.0, 1.0)


def test_both_axes_of_a_map_name_what_they_show():
    space = ParameterSpace(
        Parameter("gravity", -20.0, -2.0, log=True),
        Parameter("weather", 0.0, 3.0, choices=("sun", "rain", "hail")),
    )
    axes = scatter(space, drawn(40, 2), drawn(40, 2), 0.3).axes[0]
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["sun", "rain", "hail"]
    assert "\N{MINUS SIGN}10" in [tick.get_text() for tick in axes.get_xticklabels()]


def test_few_choices_do_not_press_the_other_bars_flat():
    space = ParameterSpace(
        Parameter("weather", 0.0, 3.0, choices=("sun", "rain", "hail")),
        Parameter("friction", 0.0, 1.0),
        Parameter("mass", 0.0, 1.0),
    )
    samples = drawn(400, 3)
    samples.mu[:, 0] = 0.9
    weather, friction, mass = marginals(space, samples, 0.3).axes[:3]
    assert weather.get_ylim()[1] > 100.0
    assert friction.get_ylim() == mass.get_ylim()
    assert friction.get_ylim()[1] < 20.0
