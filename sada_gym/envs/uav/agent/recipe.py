"""How the shipped pilots are trained."""

from __future__ import annotations

from dataclasses import dataclass

from sada_gym.envs.uav.course import Course
from sada_gym.envs.uav.world.guidance import SPEED_M_S

MILD = Course(spread=0.25, shift_m=0.5, turned_deg=15.0, speed_m_s=SPEED_M_S)
"""Tracks of all numbers of anchors, little displaced; races begin between any two gates."""


@dataclass(frozen=True)
class Imitation:
    """Settings of an imitation by DAgger.

    Attributes:
        course: What is flown.
        drones: In lockstep.
        rounds: Of flying and fitting; the reference flies the first.
        steps: Gathered in a round.
        epochs: Of fitting after a round.
        last_epochs: Of fitting after the last.
        batch: Rows of a gradient step.
        rate: Highest learning rate of each fitting's one-cycle schedule (Adam).
        light_jitter: How much each training picture's brightness and tint are changed.
    """

    course: Course = MILD
    drones: int = 48
    rounds: int = 6
    steps: int = 9_600
    epochs: int = 2
    last_epochs: int = 8
    batch: int = 128
    rate: float = 1.5e-3
    light_jitter: float = 0.15


@dataclass(frozen=True)
class Reinforcement:
    """Settings of a training by PPO (Schulman et al. 2017).

    Attributes:
        course: What is flown.
        drones: In lockstep.
        steps: In all.
        rollout: Steps of each drone between two updates.
        batch: Rows of a gradient step.
        epochs: Passes over a rollout.
        rate: Of learning at the beginning; it falls to nothing.
        discount: Of a reward one step later.
    """

    course: Course = MILD
    drones: int = 32
    steps: int = 800_000
    rollout: int = 128
    batch: int = 512
    epochs: int = 8
    rate: float = 5e-4
    discount: float = 0.97


RECIPES: dict[str, Imitation | Reinforcement] = {
    "waypoint-pid": Imitation(),
    "ppo": Reinforcement(),
}
