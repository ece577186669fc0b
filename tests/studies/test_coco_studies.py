"""The studies of the COCO detector, tried with our own detector on our own shapes."""

import json

import numpy as np
import pytest

from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.scene import Scene, direction
from studies import case_studies, coco_classes, coco_insights, virtual_to_cycles

CAR = DetectionApplication("car")


def row(*fooled):
    ranges = zip(coco_classes.RANGES, fooled, strict=False)
    uniform = [{"pitch": list(pitch), "fooled": count} for pitch, count in ranges]
    return {
        **{"class": "car", "parameters": "paper", "views": 10, "worlds": 100, "uniform": uniform},
        "models": {"good": 9, "fair": 8},
    }


@pytest.mark.parametrize(
    ("measured", "pitch"),
    [
        (row(80), [0.0, 51.6]),
        (row(81, 80), [5.0, 45.0]),
        (row(99, 90, 4, 5), [5.0, 20.0]),
        (row(99, 90, 85, 81), None),
        (row(4, 3, 2, 1), None),
        (row(), None),
    ],
)
def test_the_first_range_that_passes_is_taken(measured, pitch):
    assert coco_classes.chosen_models(measured) == ["good"]
    assert coco_classes.chosen_range(measured) == pitch
    verdict = "| no |" if pitch is None else f"| pitch {pitch[0]:g} to {pitch[1]:g}° |"
    assert verdict in coco_classes.table([measured])


def test_a_class_is_measured_by_its_models_that_are_recognised(monkeypatch):
    class Ours(DetectionApplication):
        default_shapes = "toy_parts:first_two"

    monkeypatch.setattr(coco_classes, "CocoDetectionApplication", Ours)
    found = coco_classes.measure("car", 10, 12)
    assert list(found["models"]) == [shape.name for shape in CAR.shapes[:2]]
    assert coco_classes.chosen_models(found)  # it was trained on them
    assert found["parameters"] == "unpainted"  # they have no surfaces
    assert found["uniform"][0]["pitch"] == (0.0, 51.6)
    assert all(0 <= one["fooled"] <= 12 for one in found["uniform"])


def test_nominal_views_are_those_that_people_photograph():
    for application in (CAR, DetectionApplication("car", parameters="unpainted")):
        mu = coco_classes.nominal_mu(application, 400, np.random.default_rng(0))
        assert mu.shape == (400, len(application.parameters))
        values = dict(zip(application.parameters.names, application.parameters.physical(mu).T,
                          strict=True))  # fmt: skip
        assert 7 < values["camera_pitch_deg"].mean() < 13
        assert (np.abs(values["light_azimuth_deg"]) < 90).mean() > 0.8
        assert values["camera_distance"].max() < 14.5


def test_the_case_studies_train_try_and_go_on(tmp_path, monkeypatch):
    simple = {"object_class": "car", "shapes": "benchmark", "image_size": 64}
    scenarios = {i: {**simple, "only": CAR.shapes[i].name} for i in (1, 2)}
    monkeypatch.setattr(case_studies, "ID", "SADA-Detection-v0")
    monkeypatch.setattr(case_studies, "SCENARIOS", scenarios)
    monkeypatch.setattr(case_studies, "PAIRS", case_studies.PAIRS[:2])
    words = f"--cases viewpoint --adversaries gaussian --budget 20 --samples 8 --out {tmp_path}"
    case_studies.main(words.split())
    rows = json.loads((tmp_path / "viewpoint.json").read_text())
    assert [(one["from"], one["to"]) for one in rows] == [(1, 2), (2, 1)] * 2
    shown = {one["there"]["application"]["settings"]["only"][0] for one in rows}
    assert shown == {scenario["only"] for scenario in scenarios.values()}
    text = (tmp_path / "viewpoint.md").read_text()
    assert "| 1 | 2 | " in text
    assert "96.4, 70.4 | 0.0, 26.0" in text  # the paper's
    (tmp_path / "viewpoint.md").unlink()
    case_studies.main(words.split())
    assert (tmp_path / "viewpoint.md").read_text() == text


def test_samples_are_confirmed_in_another_renderer(tmp_path, monkeypatch):
    monkeypatch.setattr(virtual_to_cycles, "TRACK", "SADA-Detection-{}-v0")
    words = "--classes Car --adversaries random --samples 8 --renderer toy_parts:Flat --out"
    virtual_to_cycles.main([*words.split(), str(tmp_path)])
    (found,) = json.loads((tmp_path / "cycles.json").read_text())
    assert found["keywords"] == {"renderer": "toy_parts:Flat"}
    assert found["afr_there"]["rate"] == 1.0  # there is nothing to be seen
    assert "| SADA-Detection-Car-v0 | random | " in (tmp_path / "cycles.md").read_text()


def test_insights_find_the_parameter_that_matters(tmp_path, capsys):
    track = "SADA-Detection-Bus-v0"
    coco_insights.main(["--tracks", track, "--queries", "100", "--out", str(tmp_path)])
    (found,) = json.loads((tmp_path / "insights.json").read_text())
    assert set(found["total"]) == set(CAR.parameters.names)
    for bands in found["bands"].values():
        assert sum(count for _, _, count in bands) == 100
        assert sum(fooled for _, fooled, _ in bands) == found["fooled"]
    assert "| camera pitch | SADA-Detection-Bus-v0 |" in capsys.readouterr().out


def test_a_roof_mirrors_the_light_into_a_camera_opposite():
    scene = CAR.scene(np.zeros(8, np.float32), 0)
    placed = {**vars(scene), "light_azimuth_deg": 180.0, "light_pitch_deg": 30.0}
    mirrored = Scene(**{**placed, "camera_pitch_deg": 30.0})
    assert coco_insights.mirrored_deg(mirrored) == pytest.approx(0.0, abs=1e-4)
    assert coco_insights.mirrored_deg(
        Scene(**{**placed, "camera_pitch_deg": 50.0})
    ) == pytest.approx(20.0)
    assert direction(0.0, 90.0)[2] == pytest.approx(1.0)
