import numpy as np
import pytest

from sada_gym.application import Application
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.digits import DigitsApplication
from sada_gym.envs.driving import DrivingApplication
from sada_gym.envs.robot import RobotApplication
from sada_gym.envs.uav import UAVApplication
from sada_gym.foundations.frames import LegendEntry

APPLICATIONS = {
    "analytic": AnalyticApplication,
    "detection": DetectionApplication,
    "digits": DigitsApplication,
    "driving": lambda: DrivingApplication("straight"),
    "robot": RobotApplication,
    "racing": UAVApplication,
}


@pytest.fixture(scope="module", params=APPLICATIONS.values(), ids=APPLICATIONS)
def application(request) -> Application:
    return request.param()


@pytest.mark.long
def test_worlds_drawn_together_look_as_if_drawn_alone(application):
    mu = (
        np.random.default_rng(0).uniform(-1, 1, (2, len(application.parameters))).astype(np.float32)
    )
    together = [*application.render_batch(mu, [3, 4])]
    assert len(together) == 2
    np.testing.assert_array_equal(together[1], application.render(mu[1], 4))


def test_all_marks_are_declared(application):
    assert any(entry.mark != "note" for entry in application.legend)
    assert all(isinstance(entry, LegendEntry) and entry.text for entry in application.legend)


def test_bad_worlds_are_refused(application):
    with pytest.raises(ValueError, match="Expected mu of shape"):
        next(iter(application.render_batch([[0.0] * 99], [0])))
    with pytest.raises(ValueError, match="seeds"):
        [*application.render_batch(np.zeros((1, len(application.parameters))), [-1])]
