"""Draw the pictures of docs/environments/go2.md: `python -m tools.draw_go2 [RUN]`.

RUN is the folder of the attack that the page shows; without it, its chart stays as it is.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from sada_gym import load_run, make_application
from sada_gym.analyses.plots.influence import influence
from sada_gym.analyses.plots.style import png
from sada_gym.envs.go2.application import ORDINARY
from sada_gym.envs.go2.frame import summary
from sada_gym.envs.go2.start import PARAMETERS
from sada_gym.evaluations import Evaluations
from sada_gym.measures.sensitivity import fit_failures
from sada_gym.parameters import Parameter, ParameterSpace
from tools.side_by_side import differing, save

IMAGES = Path(__file__).parents[1] / "docs" / "images"
TRACK, SEED = "SADA-Go2-Walk-v0", 3
"""The first seed of all with which the slow motors alone make it fall."""
LOADED = {
    **{"step_height_m": 0.06, "payload_kg": 5.0, "push_m_s": 1.5, "push_direction_deg": 90.0},
    "slope_deg": 5.0,
}
SLOW = {**LOADED, "motor_lag_s": 0.02}
"""The same with slower motors."""


def mu_of(**changed: float) -> np.ndarray:
    """The mu of the ordinary world but for some values."""
    return PARAMETERS.normalised([{**ORDINARY, **changed}[name] for name in PARAMETERS.names])


def in_ms(parameter: Parameter) -> Parameter:
    """Return a time as the page writes it."""
    name = parameter.name.replace("delay_s", "age_of_observations_s")
    if parameter.unit != "s":
        return parameter
    low, high = 1000 * parameter.low, 1000 * parameter.high
    return replace(parameter, name=f"{name[:-1]}ms", low=low, high=high, unit="ms")


def draw_influences(folder: str) -> None:
    """Draw how the chance of failing changes with each parameter."""
    run = load_run(folder)
    worlds = Evaluations.joined([run.queries, run.samples]).valid
    threshold = make_application(TRACK).fooling_threshold
    model = fit_failures(worlds.mu, worlds.fooled(threshold))
    assert model is not None
    figure = influence(ParameterSpace(*map(in_ms, PARAMETERS)), model, run.samples, threshold)
    (IMAGES / "go2-influence.png").write_bytes(png(figure))


def main() -> None:
    """Draw a walk that holds beside one that does not."""
    application = make_application(TRACK)
    worlds = mu_of(**LOADED), mu_of(**SLOW)
    frames = [summary(application.rollouts(mu, SEED)) for mu in worlds]
    save(frames, differing(PARAMETERS, *worlds), IMAGES / "go2.png")
    for folder in sys.argv[1:]:
        draw_influences(folder)


if __name__ == "__main__":
    main()
