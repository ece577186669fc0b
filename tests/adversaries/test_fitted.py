import json
from dataclasses import dataclass
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from quick import QUICK
from safetensors.numpy import load_file, save_file

from sada_gym import adversaries
from sada_gym.adversaries.fitted import FittedAdversary
from sada_gym.adversaries.fresh import fresh_rows, row_keys
from sada_gym.adversaries.options import Options, option
from sada_gym.adversaries.query_pool import select_fooling
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.errors import AdversaryError, UserError
from sada_gym.testing import AdversaryContract, RecordingOracle


@dataclass(frozen=True)
class BoxOptions(Options):
    margin: float = option(0.0, 0, 1)


class Box(FittedAdversary):
    """Uniform in the smallest box around the queries that fooled: all that one has to write."""

    name = "box"
    options_class = BoxOptions
    presets = {"default": BoxOptions(), "wide": BoxOptions(margin=0.1)}  # noqa: RUF012

    def fit(self, queries):
        chosen = select_fooling(queries, self.threshold, self.rng, size=20).chosen
        self.low = np.maximum(chosen.min(axis=0) - self.options.margin, -1.0)
        self.high = np.minimum(chosen.max(axis=0) + self.options.margin, 1.0)

    def draw(self, n):
        return self.rng.uniform(self.low, self.high, (n, self.dimension))


class TestBox(AdversaryContract):
    def make(self, dimension, seed):
        return Box(dimension, seed=seed)


def trained(adversary):
    adversary.train(RecordingOracle(AnalyticApplication(dimension=2), budget=60))
    return adversary


def tamper(path, name, value):
    arrays = load_file(path)
    arrays[name] = np.full_like(arrays[name], value)
    save_file(arrays, path)


def test_a_presets_options_are_saved_and_described(tmp_path):
    box = trained(Box(2, seed=0, preset="wide"))
    box.save(tmp_path)
    loaded = Box.load(tmp_path)
    assert loaded.options == BoxOptions(margin=0.1)
    assert_array_equal(loaded.low, box.low)
    resolved = adversaries.resolve(f"{__name__}:Box", {"preset": "wide"})
    assert resolved == {"preset": "wide", "margin": 0.1}


@pytest.mark.parametrize("name", adversaries.names())
def test_a_file_with_numbers_that_are_not_finite_is_refused(name, tmp_path):
    if name == "cma-mae":
        pytest.importorskip("ribs")
    adversary = trained(adversaries.make(name, 2, seed=0, **QUICK.get(name, {})))
    adversary.save(tmp_path)
    path = tmp_path / "adversary.safetensors"
    intact = path.read_bytes()
    arrays = load_file(path)
    floats = [n for n in arrays if arrays[n].dtype.kind == "f" and arrays[n].size]
    for array, value in product(floats, [np.nan, np.inf]):
        tamper(path, array, value)
        with pytest.raises(UserError, match=f"{array} holds NaN or infinite numbers"):
            type(adversary).load(tmp_path)
        path.write_bytes(intact)


@pytest.mark.parametrize(
    ("name", "array", "value"),
    [
        ("cross-entropy", "0.weights", 0.0),
        ("cross-entropy", "0.weights", -1.0),
        ("gp", "length_scales", 0.0),
        ("memorise", "omega.mu", 2.0),
    ],
)
def test_a_file_with_impossible_numbers_is_refused(name, array, value, tmp_path):
    adversary = trained(adversaries.make(name, 2, seed=0))
    adversary.save(tmp_path)
    tamper(tmp_path / "adversary.safetensors", array, value)
    with pytest.raises(UserError, match="Expected a folder that"):
        type(adversary).load(tmp_path)


def test_a_file_that_thins_out_everything_ends_the_sampling(tmp_path):
    adversary = trained(adversaries.make("cross-entropy", 2, seed=0, stages=1))
    adversary.save(tmp_path)
    tamper(tmp_path / "adversary.safetensors", "odds", 1e6)
    loaded = type(adversary).load(tmp_path)
    with pytest.raises(AdversaryError, match="all were thinned out"):
        loaded.sample(3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dimension": 3}, r"omega.mu has the shape \(60, 2\), not \(60, 3\)"),
        ({"dimension": 10**6}, "Expected dimension of at most 1,000, got 1,000,000"),
        ({"options": {"margins": 1}}, "option of box to be one of margin; got 'margins'"),
        ({"options": {"margin": 2}}, "Expected margin to be a float from 0 to 1"),
        ({"adversary": "boxes"}, "saved adversary to be one of box; got 'boxes'"),
        ({"threshold": "low"}, "threshold: Input should be a valid number"),
        ({"threshold": float("nan")}, "threshold: Input should be a finite number"),
        ({"threshold": float("inf")}, "threshold: Input should be a finite number"),
        (
            {"flags": ["fine", "\x1b[2J"]},
            r"flags.1: Value error, .* control characters in '.x1b\[2J'",
        ),
        ({"flags": ["two\nlines"]}, "flags.0: Value error, expected text in one line"),
        ({"generator": {"bit_generator": "MT19937"}}, "Expected a folder that"),
        ({"more": 1}, "more: Extra inputs are not permitted"),
    ],
)
def test_a_foreign_record_is_refused_in_one_line(change, message, tmp_path):
    trained(Box(2, seed=0)).save(tmp_path)
    path = tmp_path / "adversary.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(UserError, match=message) as caught:
        Box.load(tmp_path)
    assert "\n" not in str(caught.value)


def test_arrays_of_any_memory_order_are_saved(tmp_path):
    class Turned(Box):
        def arrays(self):
            return {"turned": np.arange(6.0).reshape(2, 3).T, "low": self.low, "high": self.high}

        def restore(self, arrays):
            self.turned, self.low, self.high = arrays["turned"], arrays["low"], arrays["high"]

    trained(Turned(2, seed=0)).save(tmp_path)
    assert_array_equal(Turned.load(tmp_path).turned, np.arange(6.0).reshape(2, 3).T)


def test_nothing_but_nan_is_an_error():
    with pytest.raises(AdversaryError, match="draws NaN or infinite ones"):
        fresh_rows(lambda n, noise: np.full((n, 2), np.nan), (3, 2), set())


@pytest.mark.parametrize("rows", [0, 1])
def test_nothing_new_has_an_end(rows):
    with pytest.raises(AdversaryError, match="Expected 3 different samples, but after"):
        fresh_rows(lambda n, noise: np.zeros((rows, 2)), (3, 2), set())


def test_a_single_point_next_to_the_face_gives_many_samples():
    rng = np.random.default_rng(0)
    known = row_keys(np.ones((1, 1), np.float32))

    def one_point(n, noise):
        return np.ones((n, 1)) + noise * rng.normal(size=(n, 1))

    samples = fresh_rows(one_point, (12_000, 1), known)
    assert len(np.unique(samples)) == 12_000
    assert (np.abs(samples - 1.0) < 0.1).all()
