"""Episodes of any Gymnasium environment as shots."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from sada_gym.evaluations import fools
from sada_gym.parameters import number
from sada_gym.replay import shots
from sada_gym.replay.shots import Shot, Take

if TYPE_CHECKING:
    from sada_gym.envs.wrapped.application import GymnasiumApplication


def take(application: GymnasiumApplication, mu: shots.Mu, seed: int, seconds: float) -> Take:
    """Show how the episodes that failed ended."""
    if not application.can_render:
        application.render(mu, seed)  # says why
    rollouts = application.rollouts(mu, seed)
    threshold = application.fooling_threshold
    failed = [i for i, rollout in enumerate(rollouts) if fools(rollout.score, threshold)]
    chosen, each_s = shots.shared(failed, seconds)
    world = shots.world_words(application, mu)
    made = []
    for i in chosen:
        rollout = rollouts[i]
        last = len(rollout["frame"]) - 1
        steps, fps, remark = shots.paced(last + 1, application.render_fps, each_s)
        name = f"episode {i + 1} of {len(rollouts)}  ·  " if len(rollouts) > 1 else ""
        notes = [
            f"{name}step {step}  ·  return {number(float(rollout['return'][step]))}{remark}"
            for step in steps
        ]
        text = f"return {number(float(rollout['return'][-1]))} after {last} steps"
        ending = shots.Ending(text, fools(rollout.score, threshold))
        pictures = [Image.fromarray(rollout["frame"][step]) for step in steps]
        made.append(Shot(pictures, fps, notes, world, ending))
    return Take(made, float(np.mean([rollout.score for rollout in rollouts])))
