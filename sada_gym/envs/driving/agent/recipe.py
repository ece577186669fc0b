"""How the shipped drivers are trained."""

from __future__ import annotations

from dataclasses import dataclass

from sada_gym.envs.driving.course import Course

SETTING_OFF = Course(lateral_m=0.8, turned_deg=8.0, speed_m_s=8.0)
"""Default camera, the four training weathers; cars set off from anywhere near a lane's middle."""

JITTERED = Course(
    height_m=(1.15, 1.65),
    pitch_deg=(-17.5, -12.5),
    lateral_m=0.8,
    turned_deg=8.0,
    speed_m_s=8.0,
)
"""The same with another camera each drive: half of the benchmark's range of either parameter."""


@dataclass(frozen=True)
class Imitation:
    """Settings of an imitation by DAgger.

    Attributes:
        course: What is driven.
        cars: In lockstep.
        rounds: Of driving and fitting; the expert drives the first.
        steps: Gathered in a round.
        epochs: Of fitting after a round.
        last_epochs: Of fitting after the last.
        batch: Rows of a gradient step.
        rate: Highest learning rate of each fitting's one-cycle schedule (Adam).
        light_jitter: How much each training picture's brightness, contrast and tint are changed.
    """

    course: Course = SETTING_OFF
    cars: int = 64
    rounds: int = 8
    steps: int = 8_000
    epochs: int = 3
    last_epochs: int = 8
    batch: int = 128
    rate: float = 5e-4
    light_jitter: float = 0.25


@dataclass(frozen=True)
class Reinforcement:
    """Settings of a training by PPO (Schulman et al. 2017).

    Attributes:
        course: What is driven.
        begins_as: The shipped driver whose weights it starts from; None: from scratch.
        cars: In lockstep.
        steps: In all.
        value_steps: Steps at first in which the value alone is learnt, the driver being kept: an
            imitator knows no values, and steps by wrong ones would spoil it.
        rollout: Steps of each car between two updates.
        batch: Rows of a gradient step.
        epochs: Passes over a rollout.
        rate: Of learning at the beginning; it falls to nothing.
        discount: Of a reward one step later.
    """

    course: Course = SETTING_OFF
    begins_as: str | None = "cil"
    cars: int = 32
    steps: int = 200_000
    value_steps: int = 40_000
    rollout: int = 128
    batch: int = 512
    epochs: int = 4
    rate: float = 1e-4
    discount: float = 0.97


RECIPES: dict[str, Imitation | Reinforcement] = {
    "cil": Imitation(),
    "cil-augmented": Imitation(course=JITTERED, light_jitter=0.4),
    "ppo": Reinforcement(),
}
