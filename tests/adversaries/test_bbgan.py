import json
import sys
import types

import numpy as np
import pytest
import torch

from sada_gym.adversaries.bbgan import BBGAN, BoostedBBGAN, split_budget
from sada_gym.adversaries.bbgan_networks import fold
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.errors import AdversaryError, TrainingDiverged, UserError
from sada_gym.testing import AdversaryContract, RecordingOracle
from studies.landscapes import FunctionOracle, Landscape

QUICK = {"steps": 20, "batch": 16, "generator": (16,), "discriminator": (16,)}


class TestBBGAN(AdversaryContract):
    def make(self, dimension, seed):
        return BBGAN(dimension, seed=seed, **QUICK)


class TestPaperBBGAN(AdversaryContract):
    def make(self, dimension, seed):
        return BBGAN(dimension, seed=seed, preset="paper", steps=20)


class TestBoostedBBGAN(AdversaryContract):
    def make(self, dimension, seed):
        return BoostedBBGAN(dimension, seed=seed, **QUICK)


def attack(adversary, application, budget=2000, n=1000):
    adversary.train(RecordingOracle(application, budget=budget))
    return application.fooling_region(adversary.sample(n))


@pytest.mark.long
@pytest.mark.parametrize(
    ("dimension", "afr", "each"),
    [
        pytest.param(2, 0.9, 0.1, marks=pytest.mark.slow),
        pytest.param(3, 0.85, 0.1, marks=pytest.mark.slow),
        pytest.param(5, 0.7, 0.08, marks=pytest.mark.slow),
        (8, 0.45, 0.05),
    ],
)
def test_covers_all_fooling_regions(dimension, afr, each):
    """A uniform sampler fools 10 % of the time, and each region gets 2.5 %."""
    region = attack(BBGAN(dimension, seed=0), AnalyticApplication(dimension=dimension))
    assert (region >= 0).mean() >= afr
    assert (np.bincount(region[region >= 0], minlength=4) / len(region)).min() >= each


@pytest.mark.long
def test_leads_random_where_the_world_is_random_and_boosting_is_no_worse():
    rate = {}
    for kind in (BBGAN, BoostedBBGAN):
        landscape = Landscape(0)
        adversary = kind(8, seed=0, steps=150)
        oracle = FunctionOracle(landscape, 2000)
        adversary.train(oracle)
        assert oracle.remaining == 0
        rate[kind.name] = landscape.fooling_rate(adversary.sample(2000)).mean()
    assert rate["bbgan"] > 0.35 + 0.2
    assert rate["bbgan-boost"] > rate["bbgan"] - 0.02


def test_the_paper_preset():
    o = BBGAN(3, preset="paper").options
    assert (o.latent, o.generator, o.discriminator) == (17, (10,) * 4, (10,) * 3)
    assert (o.discriminator_updates, o.generator_updates, o.beta1) == (1, 2, 0.5)
    assert (o.induced_size, o.rest, o.transport, o.fold) == (100, 0.0, False, False)
    boosted = BoostedBBGAN(3, preset="paper").options
    assert (boosted.share, boosted.copies) == (0.1, 5)
    assert BBGAN(3, preset="paper", steps=7).options.steps == 7


@pytest.mark.parametrize("budget", [1, 2, 7, 100, 2000, 20_000])
@pytest.mark.parametrize("preset", ["default", "paper"])
def test_boosting_spends_all_of_the_budget(budget, preset):
    o = BoostedBBGAN.presets[preset]
    uniform, share = split_budget(budget, o)
    assert uniform + o.stages * share == budget
    assert uniform >= 1


def test_omega_holds_unique_points_and_the_paper_preset_copies():
    for preset in ("default", "paper"):
        adversary = BoostedBBGAN(2, seed=0, preset=preset, steps=5)
        oracle = RecordingOracle(AnalyticApplication(), budget=120)
        adversary.train(oracle)
        assert len(adversary.queries) == 120
        assert (adversary.queries.mu == oracle.queries).all()


@pytest.mark.parametrize("fooling", [0, 1, 5, 60])
@pytest.mark.parametrize("kind", [BBGAN, BoostedBBGAN])
def test_few_fooling_points_or_none_or_only_such(kind, fooling):
    def score(mu):
        return np.where(np.arange(len(mu)) < fooling, 0.1, 0.5 + 0.1 * mu[:, 0])

    adversary = kind(8, seed=0, **QUICK)
    adversary.train(FunctionOracle(score, 60))
    assert adversary.sample(50).shape == (50, 8)
    if kind is BBGAN:
        assert bool(adversary.flags) == (fooling == 0)


def test_a_collapsed_generator_still_gives_fresh_samples():
    adversary = BBGAN(2, seed=0, preset="paper", steps=1)
    adversary.train(RecordingOracle(AnalyticApplication(), budget=50))
    for parameter in adversary._g.parameters():
        parameter.data.zero_()
    assert len(np.unique(adversary.sample(500), axis=0)) == 500


def test_training_that_diverges_is_an_error_that_says_what_to_change():
    deep = {"initial_sd": 10.0, "generator": [512] * 12, "discriminator": [512] * 12}
    adversary = BBGAN(2, seed=0, steps=3, batch=8, **deep)
    with pytest.raises(TrainingDiverged, match=r"Lower learning_rate .* or initial_sd"):
        adversary.train(RecordingOracle(AnalyticApplication(), budget=40))


@pytest.mark.parametrize("acceptance", [0.0, 0.9])
def test_weights_that_are_not_finite_end_the_sampling(acceptance):
    adversary = BBGAN(2, seed=0, acceptance=acceptance, **QUICK)
    adversary.train(RecordingOracle(AnalyticApplication(), budget=50))
    for parameter in adversary._g.parameters():
        parameter.data.fill_(float("nan"))
    with pytest.raises(AdversaryError, match="draws NaN or infinite ones"):
        adversary.sample(10)


def test_a_discriminator_that_accepts_nothing_ends_the_sampling():
    adversary = BBGAN(2, seed=0, **QUICK)
    adversary.train(RecordingOracle(AnalyticApplication(), budget=50))
    adversary._ceiling = torch.tensor(1e30)
    assert adversary.sample(20).shape == (20, 2)


def test_loading_writes_to_no_path_that_a_file_names(tmp_path, monkeypatch):
    module = types.ModuleType("torch.utils.tensorboard")
    module.SummaryWriter = Writer
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", module)
    adversary = BBGAN(2, seed=0, log_dir=tmp_path / "log", **QUICK)
    adversary.train(RecordingOracle(AnalyticApplication(), budget=40))
    adversary.save(tmp_path / "saved")
    path = tmp_path / "saved" / "adversary.json"
    assert "log" not in path.read_text()
    record = json.loads(path.read_text())
    record["options"]["log_dir"] = str(tmp_path / "elsewhere")
    path.write_text(json.dumps(record))
    Writer.last = None
    with pytest.raises(UserError, match=r"option of bbgan to be .*; got 'log_dir'"):
        BBGAN.load(tmp_path / "saved")
    assert Writer.last is None


def test_fold_reflects_and_reaches_the_faces():
    x = torch.tensor([0.0, 1.0, -1.0, 1.5, -1.5, 3.0, 5.0])
    assert fold(x).tolist() == [0.0, 1.0, -1.0, 0.5, -0.5, -1.0, 1.0]


def test_threads_are_as_before():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        adversary = BBGAN(2, seed=0, **QUICK)
        adversary.train(RecordingOracle(AnalyticApplication(), budget=50))
        adversary.sample(5)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_flags_and_omega_survive_saving(tmp_path):
    adversary = BBGAN(2, seed=0, **QUICK)
    adversary.train(FunctionOracle(lambda mu: np.ones(len(mu)), 40))
    adversary.save(tmp_path)
    loaded = BBGAN.load(tmp_path)
    assert loaded.flags == adversary.flags
    assert "no point of Omega fooled" in loaded.flags[0]
    assert loaded.options == adversary.options
    assert (loaded.queries.mu == adversary.queries.mu).all()


def test_broken_files_are_refused(tmp_path):
    adversary = BBGAN(2, seed=0, **QUICK)
    adversary.train(RecordingOracle(AnalyticApplication(), budget=40))
    adversary.save(tmp_path)
    with pytest.raises(ValueError, match=r"`BoostedBBGAN.save` wrote, .*saved adversary"):
        BoostedBBGAN.load(tmp_path)
    settings = json.loads((tmp_path / "adversary.json").read_text())
    settings["dimension"] = 3
    (tmp_path / "adversary.json").write_text(json.dumps(settings))
    with pytest.raises(ValueError, match=r"Expected a folder that `BBGAN.save` wrote"):
        BBGAN.load(tmp_path)
    (tmp_path / "adversary.safetensors").write_bytes(b"broken")
    with pytest.raises(ValueError, match=r"Expected a folder that `BBGAN.save` wrote"):
        BBGAN.load(tmp_path)
    with pytest.raises(ValueError, match=r"Expected a folder that `BBGAN.save` wrote"):
        BBGAN.load(tmp_path / "nowhere")


class Writer:
    """Stands in for tensorboard's."""

    def __init__(self, folder):
        self.folder, self.written = folder, set()
        Writer.last = self

    def add_scalar(self, name, value, step):
        self.written.add(name)

    add_histogram = add_figure = add_scalar

    def close(self):
        self.written.add("closed")


def test_the_log_holds_losses_and_samples_and_changes_nothing(monkeypatch, tmp_path):
    module = types.ModuleType("torch.utils.tensorboard")
    module.SummaryWriter = Writer
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", module)
    logged = BoostedBBGAN(2, seed=0, log_dir=tmp_path, **QUICK)
    silent = BoostedBBGAN(2, seed=0, **QUICK)
    for adversary in (logged, silent):
        adversary.train(RecordingOracle(AnalyticApplication(), budget=60))
    assert (logged.sample(50) == silent.sample(50)).all()
    expected = {"loss/discriminator", "stage2/loss/generator", "mu/1", "samples", "closed"}
    assert expected <= Writer.last.written


def test_a_missing_tensorboard_is_named_with_its_remedy(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install .* '\.\[track\]'"):
        BBGAN(2, log_dir=tmp_path)
