"""Which classes of textured models become tracks of SADA-DetectionCoco, and with which pitch.

    python -m studies.coco_classes --out runs/coco-classes

The rule looks at no adversary:

- a model takes part if the detector recognises it (Q > 0.3) in at least 90 % of its nominal views;
- a class is a track if a model of it takes part, and uniform worlds fool the detector (Q <= 0.3) in
  5 to 80 %;
- the camera's pitch has the paper's range, 0 to 51.6 degrees, where that passes; else the first of
  5 to 45, 5 to 30 and 5 to 20 that does;
- mu has the paper's eight parameters where most of these models can be painted, else the five
  others.

Nominal views are those that people photograph, by the prior that the shipped detectors were trained
with (`studies.training.detection.prior`): near, from three quarters in front or from the side, at
eye level, the sun behind the camera, in colours that are sold; here the object is in the middle.
At first the rule asked for 90 % of the nominal views of all models of a class together. Then one
model that the detector takes for something else, such as a BMX, ruled out its class; so now the
rule chooses the models first. What follows a range that passes is not measured. Every class is kept
in a file, so that a second call goes on.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym.envs.detection.application import DetectionApplication
from sada_gym.envs.detection.parameter_sets import COLOUR
from sada_gym.envs.detection.scene import PLACEMENT
from sada_gym.envs.detection.shapes.catalogue import CLASSES
from sada_gym.envs.detection_coco.application import CocoDetectionApplication
from sada_gym.evaluations import evaluation_seeds
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.files import write_file
from sada_gym.measures.rates import wilson_interval
from studies.training.detection.prior import photograph

RANGES = ((0.0, 51.6), (5.0, 45.0), (5.0, 30.0), (5.0, 20.0))
NOMINAL, LEAST, MOST = 0.9, 0.05, 0.8


def nominal_mu(application: DetectionApplication, count: int, rng: np.random.Generator) -> Floats:
    """Draw views that people photograph as mu, (count, d)."""
    rows = []
    for _ in range(count):
        scene = photograph(None, rng)
        values = {name: getattr(scene, name) for name in PLACEMENT}
        values |= dict(zip(COLOUR, scene.colour, strict=True))
        for name in ("camera_azimuth_deg", "light_azimuth_deg"):
            values[name] = (values[name] + 180.0) % 360.0 - 180.0
        rows.append([values[name] for name in application.parameters.names])
    return np.clip(application.parameters.normalised(rows), -1.0, 1.0).astype(np.float64)


def recognised(object_class: str, model: str, views: int) -> int:
    """Count the nominal views of a model in which the detector recognises it."""
    application = CocoDetectionApplication(object_class, only=model)
    mu = nominal_mu(application, views, np.random.default_rng(0))
    outcomes = application.evaluate(mu, evaluation_seeds(0, "validation", 0, views))
    return int((~outcomes.fooled).sum())


def measure(object_class: str, views: int, worlds: int) -> dict[str, Any]:
    """Measure a class: its models, then uniform worlds of one range after another."""
    shapes = CocoDetectionApplication(object_class).shapes
    models = {shape.name: recognised(object_class, shape.name, views) for shape in shapes}
    found: dict[str, Any] = {"class": object_class, "views": views, "worlds": worlds}
    found |= {"models": models, "uniform": []}
    chosen = chosen_models(found)
    kept = [shape for shape in shapes if shape.name in chosen]
    painted = sum(any(surface.painted for surface in shape.surfaces) for shape in kept)
    found["parameters"] = "paper" if 2 * painted > len(kept) else "unpainted"
    for pitch in RANGES if kept else ():
        application = CocoDetectionApplication(
            object_class, only=chosen, parameters=found["parameters"], camera_pitch_deg=pitch
        )
        mu = np.random.default_rng(0).uniform(-1.0, 1.0, (worlds, len(application.parameters)))
        fooled = application.evaluate(mu, evaluation_seeds(1, "validation", 0, worlds)).fooled
        found["uniform"].append({"pitch": pitch, "fooled": int(fooled.sum())})
        if chosen_range(found) is not None:
            break
    return found


def chosen_models(row: dict[str, Any]) -> list[str]:
    """Return the models of a class that take part."""
    return [name for name, count in row["models"].items() if count >= NOMINAL * row["views"]]


def chosen_range(row: dict[str, Any]) -> list[float] | None:
    """Return the first range that passes the rule; None where the class is no track."""
    for one in row["uniform"]:
        if LEAST <= one["fooled"] / row["worlds"] <= MOST:
            return list(one["pitch"])
    return None


def table(rows: list[dict[str, Any]]) -> str:
    """Write all classes as Markdown, with 95 % intervals."""
    heads = [f"uniform {low:g} to {high:g}°" for low, high in RANGES]
    lines = [
        f"| class | models | take part | d | {' | '.join(heads)} | track |",
        "| --- " * (5 + len(heads)) + "|",
    ]
    for row in rows:
        pitch, count = chosen_range(row), row["worlds"]
        verdict = "no" if pitch is None else f"pitch {pitch[0]:g} to {pitch[1]:g}°"
        cells = [_percent(one["fooled"], count) for one in row["uniform"]]
        cells += ["-"] * (len(RANGES) - len(row["uniform"]))
        size = "8" if row["parameters"] == "paper" else "5"
        numbers = [str(len(row["models"])), str(len(chosen_models(row))), size]
        lines.append(f"| {' | '.join([row['class'], *numbers, *cells, verdict])} |")
    return "\n".join(lines)


def _percent(part: int, whole: int) -> str:
    low, high = wilson_interval(part, whole)
    return f"{100 * part / whole:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=200, help="nominal views of each model")
    parser.add_argument("--worlds", type=int, default=200, help="uniform worlds of each range")
    parser.add_argument("--classes", nargs="*", default=list(CLASSES))
    parser.add_argument("--out", type=Path, default=Path("runs/coco-classes"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for object_class in arguments.classes:
        path = arguments.out / f"{object_class}.json"
        if not path.exists():
            try:
                row = measure(object_class, arguments.views, arguments.worlds)
            except ValueError as error:
                print(f"{object_class}: {error}", flush=True)
                continue
            write_file(path, json.dumps(row, indent=2).encode())
        rows.append(json.loads(path.read_text()))
        print(table(rows[-1:]).splitlines()[-1], flush=True)
    print(f"\n{table(rows)}\n")
    print("| model | nominal recognised |\n| --- | --- |")
    for row in rows:
        for name, found in row["models"].items():
            print(f"| {name} | {_percent(found, row['views'])} |")


if __name__ == "__main__":
    main()
