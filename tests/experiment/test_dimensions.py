"""From one parameter to sixty: an attack, and all that is made of its run."""

from __future__ import annotations

from pathlib import Path

import pytest
from toy import Toy

from sada_gym import adversaries, attack, diagnose
from sada_gym.analyses.regression.export import export
from sada_gym.analyses.regression.regress import regress
from sada_gym.analyses.replay.video import replay
from sada_gym.analyses.report.make import report
from sada_gym.analyses.rescore import transfer
from sada_gym.errors import Notice

SLOW = {"bbgan", "bbgan-boost", "cma-mae"}


class Steep(Toy):
    """Fails where its first angle is above 36 degrees."""

    def evaluate_batch(self, mu, seeds):
        scored = super().evaluate_batch(mu, seeds)
        scored.score[:] = [0.1 if row[0] > 0.4 else 0.9 for row in mu]
        return scored


@pytest.mark.long
@pytest.mark.parametrize("dimension", [1, 2, 60])
def test_a_run_of_any_dimension_is_reported_diagnosed_exported_transferred_and_replayed(
    tmp_path: Path, dimension: int
) -> None:
    application = Steep(dimension)
    folder = tmp_path / "run"
    result = attack(application, "level-set", budget=100, samples=40, out=folder, seed=1)
    assert result.diagnosis is not None
    assert result.diagnosis.weaknesses[0].text.startswith("angle0 is above 3")
    assert (folder / "report.html").is_file()
    assert {path.name for path in result.pictures} >= {"marginals.png", "scores.png"}
    assert diagnose(folder, application=application) == result.diagnosis
    assert report(folder, application=application) == folder / "report.html"
    suite = export(folder, tmp_path / "suite", application=application)
    assert suite.suite.groups == (result.diagnosis.weaknesses[0].text,)
    assert regress(suite.path, application).exit_code == 0
    (moved,) = transfer(folder, application, application=application).comparisons
    assert moved.afr_there.fooled == result.result.fooled
    assert replay(folder, worst=1, application=application).samples


@pytest.mark.parametrize("adversary", sorted({*adversaries.names()} - SLOW))
def test_every_adversary_attacks_one_parameter(tmp_path: Path, adversary: str) -> None:
    options = {"budget": 60, "samples": 20, "pictures": False, "html": False, "diagnose": False}
    result = attack(Steep(1), adversary, out=tmp_path / "run", **options)
    assert result.samples.mu.shape == (20, 1)


def test_an_attack_says_before_it_begins_that_its_result_will_say_little(tmp_path: Path) -> None:
    with pytest.warns(Notice) as said:
        attack(Steep(1), "gaussian", budget=10, samples=1, out=tmp_path / "a", pictures=False)
    texts = [str(one.message) for one in said]
    assert any("From 10 queries gaussian can hardly learn" in text for text in texts)
    assert any("the true rate could be 21 %. Draw at least 10" in text for text in texts)
