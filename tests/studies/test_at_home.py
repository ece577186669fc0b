"""The script that measures any detector in our worlds."""

import re
from argparse import Namespace

import numpy as np

from sada_gym import agents
from sada_gym.envs.detection import DetectionApplication
from studies.training.detection.at_home import measure, views


def test_a_detector_knows_the_views_that_people_photograph():
    detector = agents.load("photographer", "SADA-Detection")
    applications = [DetectionApplication(name, agent=detector) for name in ("car", "bottle")]
    table = measure(applications, Namespace(seed=0, frames=6, samples=4))
    rows = re.findall(r"^\| (\w+) \| (0\.\d+|1\.00) \| 0\.\d+ \| \d+\.\d % \(", table, re.M)
    assert [name for name, _ in rows] == ["car", "bottle"]
    assert all(float(precision) > 0.5 for _, precision in rows)


def test_views_show_the_object():
    application = DetectionApplication("chair", image_size=64)
    images, boxes, found = views(application, 3, np.random.default_rng(0))
    assert images.shape[1:] == (64, 64, 3)
    assert len(images) == len(boxes) == len(found)
    assert (boxes[:, 2] > boxes[:, 0]).all()
