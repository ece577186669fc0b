"""Detectors, classifiers, drivers and pilots keep one contract."""

import pytest
from drivers import as_driver

from sada_gym import agents
from sada_gym.agents.contract import Agent, as_agent, identity_of
from sada_gym.envs.detection.detector import DetectorAgent
from sada_gym.envs.digits.classifier import ClassifierAgent
from sada_gym.envs.uav.agent.pilot import PrivilegedPilot, as_pilot
from studies.training.driving.privileged import PrivilegedDriver

MAKERS = {
    "SADA-Detection": DetectorAgent,
    "SADA-Digits": ClassifierAgent,
    "SADA-Driving": as_driver,
    "SADA-UAV": as_pilot,
}


@pytest.mark.parametrize("application", MAKERS)
def test_shipped_agents_keep_it(application):
    agent = MAKERS[application](agents.load(agents.names(application)[0], application))
    assert isinstance(agent, Agent)
    assert len(agent.fingerprint) == 64
    assert agent.start(3) is None


def test_what_keeps_it_is_taken_as_it_is():
    for make, agent in ((as_driver, PrivilegedDriver()), (as_pilot, PrivilegedPilot())):
        assert make(agent) is agent


def test_what_does_not_is_told_what_it_lacks():
    class Mute:
        fingerprint = "mute"

        def start(self, count):
            pass

    message = r"Expected a model, or an object with .*, got Mute, which has no act\. Add what is"
    with pytest.raises(ValueError, match=message):
        as_agent(Mute(), policy=None, kinds="a model")


def test_a_name_stands_for_the_settings_as_well():
    class Tuned(PrivilegedPilot):
        settings = {"gain": 1.0}  # noqa: RUF012

    tuned, plain = Tuned(), PrivilegedPilot()
    assert (
        identity_of(tuned, "given", None) == identity_of(plain, "given", None) == plain.fingerprint
    )
    assert identity_of(tuned, "given", "mine") != identity_of(plain, "given", "mine")
