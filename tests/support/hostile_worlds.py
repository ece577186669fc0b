"""An application whose names would do harm in a page or a spreadsheet that took them as code."""

import numpy as np

from sada_gym.application import Application, Scored
from sada_gym.foundations.behaviour import Behaviour
from sada_gym.foundations.frames import LegendEntry
from sada_gym.parameters import Parameter, ParameterSpace

TAG = "</script><script>alert(1)</script>"
FORMULA = '=HYPERLINK("http://x.invalid")'


class Hostile(Application):
    """Q follows the first parameter."""

    name = "Hostile"
    fooling_threshold = 0.3
    sample_size = 40
    agent_name = "<img src=x onerror=alert(1)>"
    parameters = ParameterSpace(
        Parameter(TAG, 0.0, 2.0, unit="m/s"),
        Parameter(FORMULA, 0.001, 10.0, log=True),
        Parameter("kind", 0.0, 1.0, choices=("@SUM(A1)", "-1", 'a "b", c')),
        Parameter("count", 0.5, 4.5, whole=True),
        Parameter("score", -180.0, 180.0, unit="deg", directions=("a", "b", "c", "d")),
    )

    @property
    def legend(self):
        return (LegendEntry("<b>bold</b> & 'quoted'", "#d55e00", "dashed box"),)

    def evaluate_batch(self, mu, seeds):
        return Scored((mu[:, 0].astype(float) + 1) / 2, [{} for _ in seeds])

    def behaviour(self, info):
        return Behaviour("+hit <a gate>", events=("+hit <a gate>",))

    def render(self, mu, seed):
        frame = np.full((40, 60, 3), 255, np.uint8)
        frame[:, : int(30 * (mu[0] + 1)) + 1] = 40
        return frame
