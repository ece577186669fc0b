"""The summary writes values as people say them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from wrapped_toys import cart_pole

from sada_gym import attack
from sada_gym.envs.wrapped import ActionDelay, Keyword
from sada_gym.measures import sensitivity
from sada_gym.run.summary import laid_out


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
    assert "motor from strong to off" in text
    assert "late from 0 to" in text or "motor from strong to off, and nothing else" in text
    assert "motor 0" not in text
    assert all(len(line) <= 80 or str(tmp_path) in line for line in text.splitlines())


@pytest.mark.parametrize("width", [30, 60, 80])
def test_lines_fit_and_break_between_words_but_commands_stay_whole(width):
    rows = [
        (
            "where",
            "1. speed is above 3 m/s and wind is below 12 m/s or the road is wet\n   31 % fail",
        ),
        ("next", "sada-gym export runs/a-folder --out suite.json --confirm 3"),
    ]
    lines = [f"{lead}{text}" for _, lead, text in laid_out(rows, width)]
    assert all(len(line) <= width or "sada-gym" in line for line in lines)
    assert " ".join(" ".join(lines).split()) == " ".join(" ".join(sum(rows, ())).split())
    assert any(line.endswith(rows[1][1]) for line in lines)


def test_the_first_rows_say_how_often_where_and_what_to_do_next(tmp_path: Path) -> None:
    run = attack("SADA-Digits-3-v0", out=tmp_path / "run", budget=400, samples=40, progress=False)
    lines = str(run).splitlines()
    assert lines[0] == "cnn in SADA-Digits-3-v0, attacked by level-set"
    names = [name for name, _ in (*run.rows(), *run.further())]
    assert names == ["fails in", "where", "what matters", "open", "next"]
    assert " of all worlds in the ranges (" in lines[1]
    assert " of worlds that level-set makes (" in lines[2]
    assert all(" sada-gym " in line for line in lines[-2:])
    for word in ("novelty", "mu_std", "spread", "training", "AFR"):
        assert word not in str(run)
