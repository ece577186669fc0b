"""Samples of a run, scored elsewhere: the right worlds, seeds and physical values."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from breaking_worlds import breaking, breaks
from toy import Toy

from sada_gym import Parameter, ParameterSpace, attack, make_application
from sada_gym.analyses.mapping import map_samples
from sada_gym.analyses.rescore import Comparison, Transfers, confirm, rescore, transfer
from sada_gym.errors import FileError, UserError, UserTypeError
from sada_gym.evaluation.evaluator import Evaluated, Evaluator
from sada_gym.foundations.files import read_model, write_model
from sada_gym.measures.rates import attack_fooling_rate
from sada_gym.run.folder import RunRecord, read_record, read_samples, write_samples
from sada_gym.run.given import Given

ANALYTIC = "SADA-Analytic-v0"


def run(folder: Path, environment=ANALYTIC, samples: int = 40, **keywords) -> Path:
    given = {"budget": 0, "seed": 0, "pictures": False, **keywords}
    return attack(environment, "random", samples=samples, out=folder, **given).folder


@pytest.fixture(scope="module")
def analytic(tmp_path_factory) -> Path:
    return run(tmp_path_factory.mktemp("transfer") / "a run", env_kwargs={"volume": 0.3})


def test_the_figures_are_those_of_the_samples_in_the_other_world(analytic):
    samples = read_samples(analytic / "samples.npz")
    (row,) = transfer(analytic, ANALYTIC, env_kwargs={"volume": 0.4}).comparisons
    application = make_application(ANALYTIC, volume=0.4)
    outcomes = application.evaluate(samples.mu, samples.seed.tolist())
    fooled = samples.fooled(0.3)
    assert row.afr_here.rate == fooled.mean()
    assert row.afr_there.rate == outcomes.fooled.mean() > row.afr_here.rate
    rate = attack_fooling_rate(outcomes.score, 0.3)
    assert row.afr_there.interval_95 == (rate.low, rate.high)
    assert row.both.fooled == (fooled & outcomes.fooled).sum()
    assert row.both.samples == fooled.sum()
    assert row.new.fooled == (~fooled & outcomes.fooled).sum()
    assert row.new.samples == (~fooled).sum()
    assert row.rank_correlation > 0.95  # the boxes stand where they stood
    assert row.there.application.settings["volume"] == 0.4
    assert row.here.application.settings["volume"] == 0.3


def test_ordinary_worlds_stand_beside_the_samples(analytic):
    (row,) = transfer(analytic, ANALYTIC, env_kwargs={"volume": 0.4}).comparisons
    assert row.ordinary.samples == 40  # as many as samples
    assert 0.2 < row.ordinary.rate < 0.6  # even ones: no density is known
    (all_fail,) = transfer(analytic, ANALYTIC, env_kwargs={"volume": 0.9}).comparisons
    assert all_fail.ordinary.rate > row.ordinary.rate
    assert rescore(analytic, ANALYTIC, env_kwargs={"volume": 0.4}).comparison.ordinary is None


def test_every_run_is_tried_in_every_track_and_the_figures_survive_json(analytic, tmp_path):
    other = run(tmp_path / "other", seed=1)
    tried = transfer([analytic, other], ["SADA-Analytic-v0", "sada_gym:SADA-Analytic-v0"])
    assert [(Path(row.run).name, row.there.track) for row in tried.comparisons] == [
        ("a run", "SADA-Analytic-v0"),
        ("a run", "sada_gym:SADA-Analytic-v0"),
        ("other", "SADA-Analytic-v0"),
        ("other", "sada_gym:SADA-Analytic-v0"),
    ]
    assert tried.comparisons[2].rank_correlation == pytest.approx(1.0)
    assert Transfers.model_validate_json(tried.model_dump_json()) == tried


def test_samples_keep_their_seeds_unless_others_are_drawn(tmp_path):
    folder = run(tmp_path / "run", env_kwargs={"noise": 0.3})
    same, drawn = (
        transfer(folder, ANALYTIC, env_kwargs={"noise": 0.3}, seed=seed).comparisons[0]
        for seed in (None, 5)
    )
    assert same.rank_correlation == pytest.approx(1.0)
    assert same.afr_there == same.afr_here
    assert drawn.rank_correlation < 0.999


def test_rescoring_gives_the_scores_of_each_sample_there(analytic):
    samples = read_samples(analytic / "samples.npz")
    there = rescore(analytic, ANALYTIC, env_kwargs={"volume": 0.4})
    outcomes = make_application(ANALYTIC, volume=0.4).evaluate(samples.mu, samples.seed.tolist())
    np.testing.assert_array_equal(there.scores.score, outcomes.score)
    np.testing.assert_array_equal(there.scores.seed, samples.seed)
    (tried,) = transfer(analytic, ANALYTIC, env_kwargs={"volume": 0.4}).comparisons
    assert there.comparison == tried.model_copy(update={"ordinary": None})


def test_a_run_is_rescored_in_one_world_alone(analytic):
    with pytest.raises(UserTypeError, match="Expected an id or an Application"):
        rescore(analytic, [ANALYTIC, ANALYTIC])


def test_fresh_seeds_need_no_other_world(tmp_path):
    noisy = Toy()
    folder = run(tmp_path / "run", noisy)
    again = rescore(folder, seed=5, application=noisy)
    assert not {*again.scores.seed} & {*read_samples(folder / "samples.npz").seed}
    assert again.comparison.there == again.comparison.here
    assert 0.0 < again.comparison.rank_correlation < 0.999


def test_the_first_samples_can_be_taken(analytic):
    (row,) = transfer(analytic, ANALYTIC, samples=7).comparisons
    assert row.afr_here.samples == row.afr_there.samples == 7
    assert row.afr_here.fooled == read_samples(analytic / "samples.npz")[:7].fooled(0.3).sum()
    with pytest.raises(UserError, match="Expected samples of at most 40, got 41"):
        transfer(analytic, ANALYTIC, samples=41)


def test_an_agent_is_kept_where_a_track_has_it_and_exchanged_by_name(tmp_path):
    car = "SADA-Detection-Car-v0"
    folder = run(tmp_path / "run", car, env_kwargs={"agent": "surveyor"}, samples=3)
    kept, own, other = (
        transfer(folder, to, agent=agent).comparisons[0].there
        for to, agent in (("SADA-Detection-Bus-v0", None), ((), "photographer"), (car, None))
    )
    assert (kept.track, kept.agent) == ("SADA-Detection-Bus-v0", "surveyor")
    assert (own.track, own.agent) == (car, "photographer")
    assert (other.track, other.agent) == (car, "surveyor")


def test_what_has_no_fooling_sample_has_no_precision(tmp_path):
    folder = run(tmp_path / "run", Toy(offset=0.9))
    (row,) = transfer(folder, Toy(), application=Toy(offset=0.9)).comparisons
    assert row.both is None
    assert row.new.samples == 40
    (row,) = transfer(folder, Toy(offset=1.0), application=Toy(offset=0.9)).comparisons
    assert row.rank_correlation is None  # all scores there are 1


def test_physical_values_stay_and_what_lies_outside_is_moved_and_counted():
    here = ParameterSpace(
        Parameter("pitch_deg", 0.0, 50.0, "deg"), Parameter("distance", 8.0, 14.5, "m")
    )
    other_space = ParameterSpace(
        Parameter("distance", 8.0, 14.5, "m"), Parameter("pitch_deg", 5.0, 30.0, "deg")
    )
    mu = np.array([[-0.2, 0.1], [0.2, 0.3], [-0.9, -1.0]], np.float32)  # 20, 30, 2.5 degrees
    moved, clipped = map_samples(mu, here, other_space, "a run", "a track")
    assert np.array_equal(moved[:, 0], mu[:, 1])  # to the bit
    np.testing.assert_allclose(other_space.physical(moved)[:2, 1], [20.0, 30.0], atol=1e-5)
    assert other_space.physical(moved)[2, 1] == 5.0
    assert np.abs(moved).max() <= 1.0
    assert clipped == {"pitch_deg": 1}


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ([Parameter("yaw_deg", 0, 1, "deg")], "lacks pitch_deg and has besides yaw_deg"),
        ([Parameter("pitch_deg", 0, 1, "rad")], "in the unit and with the choices"),
        ([Parameter("pitch_deg", 0, 1, "deg", choices=("a", "b"))], "with the choices"),
    ],
)
def test_other_parameters_are_refused(other, message):
    here = ParameterSpace(Parameter("pitch_deg", 0.0, 1.0, "deg"))
    with pytest.raises(UserError, match=message):
        map_samples(np.zeros((1, 1), np.float32), here, ParameterSpace(*other), "R", "T")


def test_a_run_is_confirmed_and_the_scores_lie_in_its_folder(tmp_path):
    folder = run(tmp_path / "run", env_kwargs={"volume": 0.4})
    confirmation = confirm(folder, {"volume": 0.2})
    comparison, samples = confirmation.comparison, read_samples(folder / "samples.npz")
    assert read_model(folder / "confirmed.json", Comparison) == comparison
    scores = read_samples(folder / "confirmed.npz")
    assert np.array_equal(scores.mu, samples.mu)
    assert np.array_equal(scores.seed, samples.seed)
    expected = make_application(ANALYTIC, volume=0.2).evaluate(samples.mu, samples.seed.tolist())
    assert np.array_equal(scores.score, expected.score)
    assert comparison.new.fooled == 0  # smaller boxes in the same places
    assert 0 < comparison.both.fooled < comparison.both.samples
    before = (folder / "confirmed.json").read_bytes()
    with pytest.raises(FileError, match=r"got one with {'volume': 0.2}. Name another file"):
        confirm(folder, {"volume": 0.3})
    assert (folder / "confirmed.json").read_bytes() == before
    other = confirm(folder, {"volume": 0.3}, out=tmp_path / "b.json")
    assert read_model(tmp_path / "b.json", Comparison) == other.comparison
    assert (tmp_path / "b.npz").exists()


def test_the_keywords_of_the_run_stay_where_they_are_not_changed(tmp_path):
    folder = run(tmp_path / "run", env_kwargs={"volume": 0.4, "regions": 2, "dimension": 3})
    settings = confirm(folder, {"noise": 0.1}).comparison.there.application.settings
    assert settings == {"dimension": 3, "regions": 2, "volume": 0.4, "noise": 0.1}
    with pytest.raises(UserError, match=r"which lacks x2. Choose a track"):
        confirm(folder, {"dimension": 2})


@pytest.mark.parametrize("call", ["confirm", "transfer"])
def test_a_stopped_call_goes_on_where_it_was(tmp_path, call):
    folder = run(tmp_path / "run", samples=80)

    def again(on_scores):
        if call == "confirm":
            return confirm(folder, {"volume": 0.2}, on_scores=on_scores).comparison
        (row,) = transfer(
            folder, ANALYTIC, env_kwargs={"volume": 0.2}, on_scores=on_scores
        ).comparisons
        return row

    def stop(done, _total, _cached):
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        again(stop)
    assert not (folder / "confirmed.json").exists()
    seen = []
    report = again(lambda *counts: seen.append(counts))
    total = {"confirm": 80, "transfer": 160}[call]  # with as many ordinary worlds
    assert 0 < seen[-1][2] < total  # those of the first call came from the store
    assert seen[-1][:2] == (total, total)
    assert report == again(lambda *_: None)


def test_workers_change_nothing(analytic):
    first, two = (
        transfer(analytic, ANALYTIC, seed=seed, workers=workers)
        for seed, workers in ((3, 1), (3, 2))
    )
    assert first == two


def test_a_run_of_a_toml_file_is_tried_in_another_one(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    text = """
environment = "CartPole-v1"
agent = "transfer_pole:right"
agent_id = "always right"
score = ["length", 100]
fooling_threshold = 0.5
[parameters]
length = { kind = "attribute", low = 0.25, high = %s, unit = "m" }
"""
    (tmp_path / "transfer_pole.py").write_text("def right(observation):\n    return 1\n")
    files = [tmp_path / "cart.toml", tmp_path / "short cart.toml"]
    for file, high in zip(files, ("2.0", "1.0"), strict=True):
        file.write_text(text % high)
    folder = run(tmp_path / "run", str(files[0]), samples=6)
    (row,) = transfer(folder, files[1]).comparisons
    record = read_record(folder)  # as if the application had been made in Python
    write_model(
        folder / "attack.json", RunRecord(settings=record.settings, given=Given(by="python"))
    )
    with pytest.raises(UserError, match=r"name that by --application FILE.toml"):
        transfer(folder, str(files[1]))
    assert (row,) == transfer(folder, files[1], application=str(files[0])).comparisons
    outside = read_samples(folder / "samples.npz").mu[:, 0] > -1 + 2 * 0.75 / 1.75
    assert row.clipped == {"length": outside.sum()}
    with pytest.raises(UserError, match=r"sada-gym transfer --to FILE.toml"):
        transfer(folder, env_kwargs={"a": 1}, application=str(files[0]))


def test_a_run_of_another_version_is_refused(analytic, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    for name in ("attack.json", "samples.npz"):
        (folder / name).write_bytes((analytic / name).read_bytes())
    settings = json.loads((folder / "attack.json").read_text())
    settings["settings"]["experiment"]["target"]["application"]["version"] = 7
    (folder / "attack.json").write_text(json.dumps(settings))
    with pytest.raises(UserError, match="version was 7 and is 0"):
        transfer(folder, ANALYTIC)
    settings["settings"]["experiment"]["target"]["application"]["version"] = 0
    (folder / "attack.json").write_text(json.dumps(settings))
    samples = read_samples(folder / "samples.npz")
    write_samples(folder / "samples.npz", samples[:0])
    with pytest.raises(FileError, match=r"Expected samples in .*, got none"):
        transfer(folder, ANALYTIC)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({}, "Expected a track, an agent, keywords or a seed"),
        ({"to": "SADA-Digits-3-v0"}, "lacks x0, x1 and has besides contrast"),
        ({"to": "SADA-Digit-3-v0"}, "Did you mean 'SADA-Digits-3-v0'"),
        ({"to": 3}, "Expected an id or an Application or a list of them, got 3"),
        ({"to": Toy(), "agent": "cnn"}, "Expected an agent only with ids"),
        ({"agent": "cnn", "env_kwargs": {"agent": "mlp"}}, "Expected the agent once"),
        ({"to": ANALYTIC, "env_kwargs": {"volum": 0.1}}, "Did you mean volume"),
        ({"to": ANALYTIC, "seed": -1}, "Expected seed of at least 0"),
        ({"to": ANALYTIC, "samples": 0}, "Expected samples of at least 1"),
        ({"to": ANALYTIC, "workers": 0}, "Expected workers of at least 1"),
    ],
)
def test_bad_input_is_one_sentence(analytic, keywords, message):
    with pytest.raises(UserError, match=message):
        transfer(analytic, **keywords)


def test_a_confirmation_that_changes_nothing_is_refused(analytic):
    with pytest.raises(UserError, match="Expected keywords that change the world, got none"):
        confirm(analytic, {})
    with pytest.raises(UserError, match="with which it is the one that the run"):
        confirm(analytic, {"volume": 0.3})
    with pytest.raises(UserError, match=r"Expected a file that ends in \.json"):
        confirm(analytic, {"volume": 0.2}, out="confirmed.txt")
    with pytest.raises(FileError, match="Expected a folder that `sada-gym attack` wrote"):
        confirm("nowhere", {"volume": 0.2})


def test_worlds_that_break_there_count_in_no_figure(tmp_path):
    healthy = breaking("none")
    folder = run(tmp_path / "run", healthy, samples=60)
    samples = read_samples(folder / "samples.npz")
    (row,) = transfer(folder, breaking("raises"), application=healthy).comparisons
    broken = breaks(healthy.parameters.physical(samples.mu)[:, 0])
    assert 0 < row.invalid == broken.sum()
    assert row.afr_there.samples == row.afr_here.samples == (~broken).sum()
    assert row.afr_there == row.afr_here  # the others are the same worlds


@pytest.mark.parametrize("count", [None, 30])
def test_worlds_that_broke_in_the_run_count_in_no_figure(tmp_path, count):
    weak = breaking("raises")
    folder = run(tmp_path / "run", weak, samples=60)
    invalid = read_samples(folder / "samples.npz").invalid[:count]
    given = {"application": weak, "samples": count}
    (row,) = transfer(folder, breaking("none"), **given).comparisons
    assert 0 < row.invalid == invalid.sum()
    assert row.afr_there.samples == row.afr_here.samples == (~invalid).sum()
    again = transfer(folder, breaking("none"), **given)  # from the store
    assert again.comparisons == (row,)


def test_worlds_that_break_in_the_confirmation_are_marked_in_its_file(tmp_path, monkeypatch):
    folder = run(tmp_path / "run", samples=40)
    known = read_samples(folder / "samples.npz")
    known.invalid[:2] = True
    write_samples(folder / "samples.npz", known)
    evaluate = Evaluator.evaluate

    def with_a_broken_world(self, mu, seeds, *more):
        answer = evaluate(self, mu, seeds, *more)
        return Evaluated(answer.scores, answer.cached, {1: "it broke", 5: "it broke"})

    monkeypatch.setattr(Evaluator, "evaluate", with_a_broken_world)
    found = confirm(folder, {"volume": 0.2})
    assert np.flatnonzero(read_samples(folder / "confirmed.npz").invalid).tolist() == [1, 5]
    assert found.comparison.invalid == 3
    assert found.comparison.afr_there.samples == found.comparison.afr_here.samples == 37
