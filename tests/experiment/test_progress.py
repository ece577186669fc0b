import importlib
import io
import re
import sys
import time

import numpy as np
import pytest
from rich.console import Console
from rich.text import Text
from toy import Toy

from sada_gym import adversaries, attack
from sada_gym.experiment import progress
from sada_gym.experiment.algorithm import RunProgress
from sada_gym.experiment.progress import COMPILING, AttackProgress, will_compile


class Slow(adversaries.Adversary):
    """Queries twice, and learns after each time for longer than it queries."""

    name = "slow"

    def train(self, oracle):
        for _ in range(2):
            oracle(np.zeros((oracle.remaining // 2 or 1, self.dimension)))
            time.sleep(0.3)

    def sample(self, n):
        time.sleep(0.2)
        return np.zeros((n, self.dimension), np.float32)

    def save(self, folder):
        pass

    @classmethod
    def load(cls, folder):
        raise NotImplementedError


def terminal(width=100):
    return Console(force_terminal=True, width=width, file=io.StringIO())


def shown(console):
    """What a terminal shows at last: the lines since the last time that it was redrawn."""
    return Text.from_ansi(console.file.getvalue().split("\x1b[2K")[-1]).plain


def pipe():
    return Console(file=io.StringIO(), width=60)


def test_a_stdout_that_cannot_say_whether_it_is_a_terminal_will_do(monkeypatch):
    class Pipe:
        def write(self, text):
            return len(text)

        def flush(self):
            pass

    for odd in (Pipe(), None):
        monkeypatch.setattr(sys, "stdout", odd)
        with AttackProgress(pipe()) as shown:
            shown(RunProgress("train", 0, 9, 0))


def test_each_stage_shows_its_own_time(tmp_path):
    console, started = terminal(), time.monotonic()
    with AttackProgress(console) as bars:
        attack(
            Toy(pause_s=0.01),
            Slow,
            out=tmp_path / "o",
            budget=40,
            samples=10,
            on_progress=bars,
        )
        seconds = {stage: bars._spent(stage) for stage in bars._counts}
    assert seconds["train"] >= 0.3
    assert seconds["learn"] >= 0.6
    assert seconds["sample"] >= 0.2
    assert seconds["test"] >= 0.1
    assert sum(seconds.values()) <= time.monotonic() - started
    text = shown(console)
    assert re.findall(r"Querying|Learning|Sampling|Testing|Pictures", text) == [
        *["Querying", "Learning", "Sampling", "Testing", "Pictures"]
    ]
    assert re.search(r"Querying .*30/40", text)
    assert re.search(r"Testing .*10/10", text)
    assert "Training" not in text


def test_learning_does_not_go_on_while_pictures_are_drawn():
    with AttackProgress(pipe()) as bars:
        bars(RunProgress("train", 10, 10, 0))
        bars(RunProgress("learn", 0, 0, 0))
        bars(RunProgress("pictures", 0, 1, 0))
        before = bars._spent("learn")
        time.sleep(0.05)
        assert bars._spent("learn") == before
        assert bars._spent("pictures") >= 0.05


def test_the_time_left_includes_the_learning_between_queries(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    bars = AttackProgress(pipe())
    for done in range(0, 30, 10):
        bars(RunProgress("train", done, 100, 0))
        now[0] += 1.0  # evaluates
        bars(RunProgress("train", done + 10, 100, 0))
        bars(RunProgress("learn", 0, 0, 0))
        now[0] += 4.0
    bars(RunProgress("train", 30, 100, 0))
    assert bars._rate("train") == pytest.approx(10.0)
    assert bars._left_s("train") == pytest.approx(70 * (0.1 + 0.4))
    assert bars._detail("train") == ["30/100", "10/s", "0:03", "0:35 left"]


def test_learning_and_pictures_show_the_time_left(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    bars = AttackProgress(pipe())
    for stage in ("learn", "pictures"):
        bars(RunProgress(stage, 0, 0, 0))
        for done in range(1, 5):
            now[0] += 2.0
            bars(RunProgress(stage, done, 10, 0))
        assert bars._detail(stage) == ["4/10", "0.5/s", "0:08", "0:12 left"]
    assert not bars._started


def test_a_second_training_counts_its_own_steps(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    bars = AttackProgress(pipe())
    for pace in (10.0, 1.0):
        for done in (1, 2, 3):
            now[0] += pace
            bars(RunProgress("learn", done, 10, 0))
        bars(RunProgress("train", 10, 10, 0))
    now[0] += 1.0
    bars(RunProgress("learn", 1, 10, 0))
    now[0] += 1.0
    bars(RunProgress("learn", 2, 10, 0))
    assert bars._left_s("learn") == pytest.approx(8.0)


def test_what_an_agent_prints_stays_in_stdout(capsys):
    with AttackProgress(terminal()):
        print("of the agent")
    assert capsys.readouterr().out == "of the agent\n"


def test_what_the_store_knew_is_shown_and_is_no_speed():
    bars = AttackProgress(pipe())
    bars(RunProgress("train", 0, 100, 0))
    bars(RunProgress("train", 60, 100, 60))
    assert bars._rate("train") is None
    assert "60 cached" in bars._detail("train")


def test_without_a_terminal_a_line_comes_every_while(monkeypatch):
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.05)
    monkeypatch.setattr(progress, "will_compile", lambda: False)
    console = pipe()
    with AttackProgress(console) as bars:
        bars(RunProgress("train", 0, 1_234_567, 0))
        bars(RunProgress("train", 1_000, 1_234_567, 0))
        time.sleep(0.02)
        bars(RunProgress("train", 2_000, 1_234_567, 0))
        time.sleep(0.1)
        bars(RunProgress("learn", 0, 0, 0))
        time.sleep(0.1)
    lines = console.file.getvalue().splitlines()
    assert re.fullmatch(r"Querying: 2,000/1,234,567, [\d,]+/s, 0:00, [\d:]+ left", lines[0])
    assert re.fullmatch(r"Learning: 0:00", lines[-1])


def test_a_terminal_needs_no_lines(monkeypatch):
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.01)
    calls, bars = [], AttackProgress(terminal())
    monkeypatch.setattr(bars, "_line", lambda: calls.append(1))
    with bars:
        time.sleep(0.05)
    assert calls == []


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_no_line_is_wider_than_the_terminal(width):
    console = terminal(width)
    bars = AttackProgress(console)
    bars(RunProgress("train", 0, 20_000, 0))
    bars(RunProgress("train", 5_000, 20_000, 2_000))
    bars(RunProgress("train", 5_500, 20_000, 2_000))
    with console.capture() as capture:
        console.print(bars._render())
    lines = Text.from_ansi(capture.get()).plain.splitlines()
    assert all(len(line.rstrip()) <= width for line in lines)
    words = " ".join(lines).split()
    assert {"Querying", "5,500/20,000", "2,000", "cached"} <= set(words)


def test_compiling_is_said_before_the_first_evaluation_and_only_then(monkeypatch):
    monkeypatch.setattr(progress, "will_compile", lambda: True)
    console = pipe()
    with AttackProgress(console) as bars:
        bars(RunProgress("train", 0, 100, 0))
        assert console.file.getvalue() == f"{COMPILING}\n"
        assert bars._compiling
        bars(RunProgress("train", 10, 100, 0))
        assert not bars._compiling
        bars(RunProgress("test", 0, 10, 0))
    assert console.file.getvalue() == f"{COMPILING}\n"


def test_it_is_known_whether_kernels_are_compiled_already(monkeypatch, tmp_path):
    import numba

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "doubling").mkdir()
    (tmp_path / "doubling" / "application.py").write_text("")
    (tmp_path / "doubling" / "motion.py").write_text(
        "from sada_gym.foundations.compiled import kernel\n\n\n"
        "@kernel\ndef double(x):\n    return 2 * x\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    pattern = r"doubling\.application"
    assert not will_compile(pattern)  # not loaded
    importlib.import_module("doubling.application")
    assert will_compile(pattern)  # its kernels are in a module that workers load
    importlib.import_module("doubling.motion").double(1)
    assert not will_compile(pattern)
