"""Draw the pictures of docs/environments/robot.md: `python -m tools.draw_robot`."""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from sada_gym.envs.robot.application import RobotApplication
from sada_gym.envs.robot.frame import WIDTH, snapshot, summary
from sada_gym.envs.robot.start import PARAMETERS, Conditions

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SEED = 1
TEXT = 230
"""Pixels: the height of a summary's text, which captions say."""
TURNED = Conditions(lidar_yaw_deg=27.0, obstacle_density=2.0, wheel_gain=0.1)
"""A turned lidar among many barrels: the robot is fooled."""


def mu_of(wanted: Conditions) -> np.ndarray:
    """The mu of some conditions."""
    return PARAMETERS.normalised([getattr(wanted, name) for name in PARAMETERS.names])


def main() -> None:
    """Draw all pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--agent", default="ppo")
    application = RobotApplication(agent=parser.parse_args().agent)
    nominal = np.zeros(len(PARAMETERS), np.float32)
    turned = mu_of(TURNED)
    for name, mu in (("arrived", nominal), ("fooled", turned)):
        picture = summary(application.rollouts(mu, SEED))[TEXT:]
        Image.fromarray(picture).save(IMAGES / f"robot-{name}.png")
    # half-way through one trip, with a good lidar and with the worst
    clear = mu_of(Conditions(lidar_noise_m=0.0, lidar_dropout=0.0))
    poor = mu_of(Conditions(lidar_noise_m=0.2, lidar_dropout=0.9))
    views = []
    for mu in (clear, poor):
        rollout = application.rollouts(mu, SEED)[1]
        views.append(snapshot(rollout, len(rollout["poses"]) // 2))
    pair = Image.new("RGB", (2 * WIDTH, views[0].height))
    for k, view in enumerate(views):
        pair.paste(view, (k * WIDTH, 0))
    pair.save(IMAGES / "robot-lidar.png")
    print(f"the fooled robot: Q = {application.evaluate([turned], [SEED]).score[0]}")


if __name__ == "__main__":
    main()
