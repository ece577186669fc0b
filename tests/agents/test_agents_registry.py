"""The registry's rows, and files of weights that are not what they should be."""

from importlib import import_module

import pytest
from safetensors.torch import load_file, save_file

from sada_gym import agents


@pytest.mark.parametrize("row", agents.AGENTS, ids=lambda row: f"{row.application} {row.name}")
def test_a_row_says_how_its_agent_is_loaded(row):
    module, _, function = row.loader.partition(":")
    assert callable(getattr(import_module(module), function))
    with pytest.raises(
        ValueError, match=f"Expected a file with a {row.kind}'s weights, got no.safe"
    ):
        agents.load("no.safetensors", row.application)
    with pytest.raises(ValueError, match=f"Expected a {row.kind}'s name among .*pickles"):
        agents.load("mine.zip", row.application)


@pytest.mark.parametrize("row", agents.AGENTS, ids=lambda row: f"{row.application} {row.name}")
@pytest.mark.parametrize("foreign", ["photographer", "cil", "waypoint-pid"])
def test_another_kind_of_agents_file_is_refused_with_a_way_out(row, foreign):
    card = agents.card(foreign)
    if card.application == row.application:
        return
    with pytest.raises(
        ValueError, match=f"Expected the weights of .*{foreign}.*, got .*agent=model"
    ) as caught:
        agents.load(card.path, row.application)
    assert "\n" not in str(caught.value)


def test_a_drivers_file_must_say_how_it_is_built(tmp_path):
    path = tmp_path / "mine.safetensors"
    save_file(load_file(agents.card("cil").path), path)
    with pytest.raises(
        ValueError, match=r'built as \{"branch_features": 64.*got one that does not say'
    ):
        agents.load_driver(path)
