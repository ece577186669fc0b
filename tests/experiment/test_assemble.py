"""A run's reference set is that of exactly what is attacked; attack measures with it."""

import json

import pytest
from sada_gym.experiment.assemble import find_target
from toy import Greedy, Toy

from sada_gym.attack import attack
from sada_gym.evaluation.problems import make_application
from sada_gym.experiment.record import ReferenceSummary, RunReport
from sada_gym.files import read_model
from sada_gym.measures.coverage import NEAREST
from sada_gym.measures.reference import load_reference

TRACK = "SADA-Digits-3-v0"
SMALL = {"budget": 40, "samples": 20, "seed": 1, "pictures": False}


def target_of(env_id, **env_kwargs):
    return find_target(env_id, env_kwargs, make_application(env_id, **env_kwargs))


def test_a_track_and_the_same_application_by_keywords_have_its_reference_set():
    entry = target_of("SADA-Detection-Car-v0").reference.entry
    assert (entry.track, entry.agent) == ("SADA-Detection-Car-v0", "photographer")
    entry = target_of("SADA-Detection-Car-v0", agent="surveyor").reference.entry
    assert (entry.track, entry.agent) == ("SADA-Detection-Car-v0", "surveyor")
    general = target_of("SADA-Detection-v0", object_class="bus", agent="surveyor")
    assert general.track == "SADA-Detection-v0"
    assert general.reference.entry.track == "SADA-Detection-Bus-v0"
    assert general.reference.entry.agent == "surveyor"
    assert 0 < general.summary.uniform_rate < 1


def test_other_settings_have_no_reference_set():
    assert target_of("SADA-Detection-Car-v0", image_size=160).reference is None
    analytic = target_of("SADA-Analytic-v0")
    assert analytic.reference is None
    assert analytic.split == (None, None)


def test_an_application_has_the_reference_set_of_its_track():
    application = make_application(TRACK)
    target = find_target(application, {}, application)
    assert target.track == "SADA-Digits-v0"
    assert target.reference.entry.track == TRACK


@pytest.mark.parametrize("adversary", ["gp", "gaussian"])
def test_attack_on_a_track_with_a_reference_set_measures_by_it(tmp_path, adversary):
    asked = []
    result = attack(TRACK, adversary, out=tmp_path, on_progress=asked.append, **SMALL)
    report = result.report
    reference = load_reference(TRACK, make_application(TRACK))
    assert report.settings.reference == ReferenceSummary.of(reference)
    assert 0 < report.settings.reference.uniform_rate == reference.uniform_rate < 1
    assert 0 < report.coverage < report.relative_coverage
    assert report.density > 0
    assert report.novelty.ratio > 0
    assert report.search.curve[-1].coverage > 0
    assert [one.done for one in asked if one.stage == "measure" and one.total] == [20]
    assert read_model(tmp_path / "result.json", RunReport) == report


def test_resuming_measures_the_same_by_the_same_reference_set(tmp_path):
    class StoppedError(Exception):
        pass

    def stop(progress):
        if progress.stage == "measure" and progress.done:
            raise StoppedError

    attack(TRACK, "gaussian", out=tmp_path / "whole", **SMALL)
    with pytest.raises(StoppedError):
        attack(TRACK, "gaussian", out=tmp_path / "stopped", on_progress=stop, **SMALL)
    attack(TRACK, "gaussian", out=tmp_path / "stopped", resume=True, **SMALL)
    whole, stopped = (
        (tmp_path / name / "result.json").read_bytes() for name in ("whole", "stopped")
    )
    assert whole == stopped


@pytest.mark.parametrize("problem", [Toy(), "SADA-Analytic-v0"], ids=["own", "analytic"])
def test_attack_without_a_reference_set_leaves_its_measures_out(tmp_path, problem):
    report = attack(problem, Greedy, out=tmp_path, **SMALL).report
    assert report.settings.reference is None
    assert (report.density, report.coverage, report.relative_coverage) == (None, None, None)
    assert report.novelty.ratio is None
    assert json.loads((tmp_path / "result.json").read_text())["coverage"] is None


def test_attack_with_settings_of_its_own_has_no_coverage(tmp_path):
    keywords = {"object_class": "car", "image_size": 96}
    report = attack("SADA-Detection-v0", "random", out=tmp_path, env_kwargs=keywords, **SMALL)
    assert report.report.settings.reference is None
    assert report.report.coverage is None


def test_too_few_samples_for_coverage_leave_it_out(tmp_path):
    settings = {**SMALL, "samples": NEAREST}
    report = attack(TRACK, "random", out=tmp_path, **settings).report
    assert report.coverage is None
    assert report.settings.reference.uniform_rate > 0
