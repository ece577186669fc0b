"""Episodes of any Gymnasium environment as shots."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from sada_gym.clips.shots import Clip, Shot, ShotEnding, clip_failures, describe_world, pace
from sada_gym.evaluations import fools
from sada_gym.parameters import Mu, number

if TYPE_CHECKING:
    from sada_gym.envs.wrapped.application import GymnasiumApplication


def clip(application: GymnasiumApplication, mu: Mu, seed: int, seconds: float) -> Clip:
    """Show how the episodes that failed ended."""
    if not application.can_render:
        application.render(mu, seed)  # says why
    rollouts = application.rollouts(mu, seed)
    threshold = application.fooling_threshold
    world = describe_world(application, mu)

    def shot(i: int, seconds: float) -> Shot:
        rollout = rollouts[i]
        last = len(rollout["frame"]) - 1
        steps, fps, remark = pace(last + 1, application.render_fps, seconds)
        name = f"episode {i + 1} of {len(rollouts)}  ·  " if len(rollouts) > 1 else ""
        notes = [
            f"{name}step {step}  ·  return {number(float(rollout['return'][step]))}{remark}"
            for step in steps
        ]
        text = f"return {number(float(rollout['return'][-1]))} after {last} steps"
        ending = ShotEnding(text, fools(rollout.score, threshold))
        pictures = [Image.fromarray(rollout["frame"][step]) for step in steps]
        return Shot(pictures, fps, notes, world, ending)

    score = np.array([rollout.score for rollout in rollouts])
    return clip_failures(score, fools(score, threshold), seconds, shot)
