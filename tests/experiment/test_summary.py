"""The summary writes values as people say them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from wrapped_toys import cart_pole

from sada_gym import attack
from sada_gym.envs.wrapped import ActionDelay, Keyword
from sada_gym.measures import sensitivity


class Masses:
    """Makes CartPole with a motor by its name."""

    def __call__(self, motor: str = "strong") -> Any:
        import gymnasium as gym

        env = gym.make("CartPole-v1", max_episode_steps=200)
        env.unwrapped.force_mag = {"strong": 10.0, "firm": 9.0, "off": 0.0}[motor]
        return env


def test_choices_whole_numbers_and_units_are_written_by_name(tmp_path: Path) -> None:
    application = cart_pole(
        Masses(),
        parameters={
            "motor": Keyword(choices=("strong", "firm", "off")),
            "late": ActionDelay(0, 3),
            "gravity": (5.0, 20.0),
        },
        score=("return", 0.0, 200.0),
        fooling_threshold=0.8,
    )
    fits = sensitivity._fitted.cache_info().misses
    result = attack(application, "random", out=tmp_path / "run", budget=150, samples=150)
    assert sensitivity._fitted.cache_info().misses == fits + 1, "one model for result and picture"
    text = repr(result)
    assert "motor strong" in text
    assert "motor strong to off" in text
    lines = {line[2:].split("   ")[0]: line for line in text.splitlines()}
    assert "late 0 to" in lines["smallest change"] or "late 0," in lines["nominal world"]
    assert "motor 0" not in text
