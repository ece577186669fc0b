"""A run's reference set is that of exactly what is attacked; attack measures with it."""

import json

import pytest
from toy import Greedy, Toy

from sada_gym import attack
from sada_gym.errors import UserError
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.evaluation.problems import make_application
from sada_gym.experiment.record import RunReport
from sada_gym.experiment.target import OpenTarget, ReferenceSummary, Target
from sada_gym.foundations.files import read_model
from sada_gym.measures.coverage import NEAREST
from sada_gym.measures.reference import load_reference

TRACK = "SADA-Digits-3-v0"
SMALL = {"budget": 40, "samples": 20, "seed": 1, "pictures": False}


def opened(env_id, **env_kwargs):
    with OpenTarget.of(env_id, env_kwargs) as target:
        _ = target.fooling_set  # read while it is open
        return target


def test_a_track_and_the_same_application_by_keywords_have_its_reference_set():
    entry = opened("SADA-Detection-Car-v0").reference.entry
    assert (entry.track, entry.agent) == ("SADA-Detection-Car-v0", "photographer")
    entry = opened("SADA-Detection-Car-v0", agent="surveyor").reference.entry
    assert (entry.track, entry.agent) == ("SADA-Detection-Car-v0", "surveyor")
    general = opened("SADA-Detection-v0", object_class="bus", agent="surveyor")
    assert general.target.track == "SADA-Detection-v0"
    assert general.reference.entry.track == "SADA-Detection-Bus-v0"
    assert general.reference.entry.agent == "surveyor"
    assert 0 < general.target.reference.uniform_rate < 1


def test_other_settings_have_no_reference_set():
    assert opened("SADA-Detection-Car-v0", image_size=160).target.reference is None
    analytic = opened("SADA-Analytic-v0")
    assert analytic.reference is None
    assert (analytic.fooling_set, analytic.ideal_set) == (None, None)


def test_an_application_has_the_reference_set_of_its_track():
    with OpenTarget.of(make_application(TRACK)) as target:
        assert target.target.track == "SADA-Digits-v0"
        assert target.reference.entry.track == TRACK


def test_a_target_is_opened_again_by_its_record():
    for track, keywords in (
        ("SADA-Detection-v0", {"object_class": "bus", "agent": "surveyor", "image_size": 96}),
        (TRACK, {}),
        ("toy:Toy-v0", {}),
    ):
        record = Target.model_validate_json(opened(track, **keywords).target.model_dump_json())
        with record.open() as again:
            assert (
                again.target
                == record
                == Target.of(again.application, track, reference=again.reference)
            )
            assert again.target.application == ApplicationKey.of(again.application)


def test_another_target_is_not_opened():
    record = opened(TRACK).target
    for changes in ({"fingerprint": "0"}, {"version": 7}, {"settings": {"digit": 3}}):
        key = record.application.model_copy(update=changes)
        [name] = changes
        with pytest.raises(UserError, match=rf"SADA-Digits-3-v0 against cnn as .*{name}"):
            record.model_copy(update={"application": key}).open()
    with pytest.raises(UserError, match="name was 'SADA-Digits' and is 'SADA-Analytic'"):
        record.model_copy(update={"agent": ""}).open("SADA-Analytic-v0")
    with pytest.raises(UserError, match="Expected a registered environment id"):
        record.model_copy(update={"track": "SADA-Digits-3-v9"}).open()


def test_a_closed_target_keeps_what_needs_no_application():
    target = opened(TRACK)
    assert (target.dimension, target.sample_size) == (6, 250)
    assert len(target.fooling_set) + len(target.ideal_set) == len(target.fooling_points)
    with pytest.raises(RuntimeError, match="is closed"):
        _ = target.application
    target.close()


@pytest.mark.parametrize("adversary", ["gp", "gaussian"])
def test_attack_on_a_track_with_a_reference_set_measures_by_it(tmp_path, adversary):
    asked = []
    result = attack(TRACK, adversary, out=tmp_path, on_progress=asked.append, **SMALL)
    report = result.result
    reference = load_reference(TRACK, make_application(TRACK))
    assert report.settings.experiment.target.reference == ReferenceSummary.of(reference)
    assert (
        0 < report.settings.experiment.target.reference.uniform_rate == reference.uniform_rate < 1
    )
    assert 0 < report.coverage < report.relative_coverage
    assert report.density > 0
    assert report.novelty.ratio > 0
    assert report.search.curve[-1].coverage > 0
    assert [
        progress.done for progress in asked if progress.stage == "measure" and progress.total
    ] == [20]
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
    report = attack(problem, Greedy, out=tmp_path, **SMALL).result
    assert report.settings.experiment.target.reference is None
    assert (report.density, report.coverage, report.relative_coverage) == (None, None, None)
    assert report.novelty.ratio is None
    assert json.loads((tmp_path / "result.json").read_text())["coverage"] is None


def test_attack_with_settings_of_its_own_has_no_coverage(tmp_path):
    keywords = {"object_class": "car", "image_size": 96}
    report = attack("SADA-Detection-v0", "random", out=tmp_path, env_kwargs=keywords, **SMALL)
    assert report.result.settings.experiment.target.reference is None
    assert report.result.coverage is None


def test_too_few_samples_for_coverage_leave_it_out(tmp_path):
    settings = {**SMALL, "samples": NEAREST}
    report = attack(TRACK, "random", out=tmp_path, **settings).result
    assert report.coverage is None
    assert report.settings.experiment.target.reference.uniform_rate > 0
