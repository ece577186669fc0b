"""Q grows with the distance to a point."""

from __future__ import annotations

import numpy as np

from sada_gym.application import Application, Scored
from sada_gym.parameters import Parameter, ParameterSpace


class ToyApplication(Application):
    """A ball that rolls down a slope."""

    name = "SADA-Toy"
    fooling_threshold = 0.3
    sample_size = 5

    def __init__(self, slopes: int = 2) -> None:
        self.slopes = slopes
        self.parameters = ParameterSpace(
            *(Parameter(f"slope{i}_deg", -30.0, 30.0, "deg") for i in range(slopes))
        )

    @property
    def settings(self):
        return {"slopes": self.slopes}

    def evaluate_batch(self, mu, seeds):
        score = np.clip(np.linalg.norm(mu, axis=1).astype(float), 0.0, 1.0)
        return Scored(score, [{"ending": "the ball has stopped"} for _ in seeds])

    def render(self, mu, seed):
        return np.full((40, 60, 3), 128, np.uint8)

    def replay(self, mu, seed):
        return [self.render(mu, seed)] * 3, float(self.evaluate(mu[None], [seed]).score[0])
