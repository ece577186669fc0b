"""Episodes of any Gymnasium environment as shots."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from sada_gym.clips.shots import Clip, Shot, ShotEnding, describe_world, pace, share_time
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
    failed = [i for i, rollout in enumerate(rollouts) if fools(rollout.score, threshold)]
    chosen, each_s = share_time(failed, seconds)
    world = describe_world(application, mu)
    made = []
    for i in chosen:
        rollout = rollouts[i]
        last = len(rollout["frame"]) - 1
        steps, fps, remark = pace(last + 1, application.render_fps, each_s)
        name = f"episode {i + 1} of {len(rollouts)}  ·  " if len(rollouts) > 1 else ""
        notes = [
            f"{name}step {step}  ·  return {number(float(rollout['return'][step]))}{remark}"
            for step in steps
        ]
        text = f"return {number(float(rollout['return'][-1]))} after {last} steps"
        ending = ShotEnding(text, fools(rollout.score, threshold))
        pictures = [Image.fromarray(rollout["frame"][step]) for step in steps]
        made.append(Shot(pictures, fps, notes, world, ending))
    return Clip(made, float(np.mean([rollout.score for rollout in rollouts])))
