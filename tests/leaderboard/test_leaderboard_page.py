"""The page on the leaderboard says what works: from an Optuna study to an entry."""

import importlib.util
import re
import shlex
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from sada_gym.board.results.entry import read_entry
from sada_gym.board.submission.checks import check_entry
from sada_gym.cli import app

PAGE = (Path(__file__).parents[2] / "docs" / "leaderboard.md").read_text(encoding="utf-8")


class Study:
    """What the page uses of an Optuna study, with random search in the place of TPE."""

    def __init__(self, sampler):
        self.rng, self.trials = np.random.default_rng(sampler), []

    def optimize(self, objective, n_trials):
        for _ in range(n_trials):
            trial = types.SimpleNamespace(params={})

            def suggest_float(name, low, high, trial=trial):
                return trial.params.setdefault(name, float(self.rng.uniform(low, high)))

            trial.suggest_float = suggest_float
            trial.value = float(objective(trial))
            self.trials.append(trial)


@pytest.fixture
def optuna(monkeypatch):
    """Optuna itself where it is installed, else random search behind the same names.

    Yields the range of the AFR to expect.
    """
    if importlib.util.find_spec("optuna") is not None:
        yield 0.6, 1.0
    else:
        module = types.ModuleType("optuna")
        module.create_study = Study
        module.samplers = types.SimpleNamespace(TPESampler=lambda seed: seed)
        module.logging = types.SimpleNamespace(set_verbosity=lambda level: None, WARNING=30)
        monkeypatch.setitem(sys.modules, "optuna", module)
        yield 0.2, 0.6


def test_the_study_becomes_an_entry(tmp_path, monkeypatch, optuna):
    monkeypatch.chdir(tmp_path)
    imports = "from sada_gym import Oracle\n\nimport numpy as np\nimport optuna"
    (code,) = re.findall(rf"```python\n({imports}.*?)```", PAGE, re.DOTALL)
    code = code.replace("range(3)", "range(1)").replace("budget=1_000", "budget=260")
    exec(compile(code, "leaderboard.md", "exec"), {})
    joined = PAGE.replace("\\\n", "")
    (command,) = re.findall(r"^sada-gym (submit --samples .*)$", joined, re.MULTILINE)
    command = re.sub(r"--samples mu[12]\.npy ", "", command).replace("1000", "260")
    with pytest.raises(SystemExit) as stopped:
        app(shlex.split(command))
    assert not stopped.value.code
    folder = tmp_path / "leaderboard" / "entries" / "optuna-tpe"
    check_entry(folder)
    (result,) = read_entry(folder).results.values()
    (seed,) = result.claimed.seeds
    assert seed.queries == 260
    # of the best 250 of 260 trials
    assert optuna[0] < seed.measures.afr < optuna[1]
