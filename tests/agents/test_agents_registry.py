"""The registry's rows, and files of weights that are not what they should be."""

from dataclasses import replace

import pytest
from safetensors.torch import load_file, save_file

from sada_gym import agents
from sada_gym.foundations.cards import cards, find_card
from sada_gym.foundations.lazy import load

WITH_AGENTS = [card for card in cards() if card.agents]


@pytest.mark.parametrize("card", WITH_AGENTS, ids=lambda card: card.name)
def test_a_card_says_how_its_agents_are_loaded(card):
    assert callable(load(card.agent_loader))
    either = rf"Expected an agent's name among {card.all_agents[0].name}.*, or a \.safetensors file"
    with pytest.raises(
        ValueError, match=rf"{either} with a {card.agent_kind}'s weights, got no\.s"
    ):
        agents.load("no.safetensors", card.name)
    with pytest.raises(ValueError, match=rf"{either}.*pickles"):
        agents.load("mine.zip", card.name)


def test_an_agents_row_may_name_a_loader_of_its_own(monkeypatch):
    card = find_card("SADA-Digits")
    row = replace(card.agents[0], name="own", loader="toy_parts:as_loaded")
    own = replace(card, agents=(*card.agents, row))
    monkeypatch.setattr(agents, "cards", lambda: (own,))
    monkeypatch.setattr(agents, "find_card", lambda name: own)
    assert agents.load("own", card.name) == ("loaded", row.path)
    assert agents.load("cnn", card.name).architecture == "sada_gym digits"


@pytest.mark.parametrize("card", WITH_AGENTS, ids=lambda card: card.name)
def test_a_name_and_a_file_are_both_offered(card, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = card.all_agents[0].name
    either = rf"Expected an agent's name among {first}.*, or a \.safetensors file"
    for missing in ("nofile.pt", "weights/mine", "nofile.safetensors"):
        with pytest.raises(ValueError, match=rf"{either} .*got {missing}: no such file"):
            agents.check_agent(missing, card.name)
    (tmp_path / "mine.pt").write_bytes(b"")
    with pytest.raises(ValueError, match=rf"{either}, got the file mine\.pt\. .*agent=\.\.\."):
        agents.check_agent("mine.pt", card.name)
    with pytest.raises(ValueError, match=rf"{either}, got '{first[:-1]}'\. Did you mean '{first}'"):
        agents.check_agent(first[:-1], card.name)
    with pytest.raises(ValueError, match=either):
        agents.check_agent("x" * 300, card.name)
    agents.check_agent(first, card.name)


@pytest.mark.parametrize("name", ["SADA-Analytic", "SADA-Detecton"])
def test_an_application_without_shipped_agents_gets_a_sentence(name):
    with pytest.raises(
        ValueError, match=f"one of SADA-Detection, .*, got '{name}'. Pass the agent itself."
    ):
        agents.load("photographer", name)


@pytest.mark.parametrize("card", WITH_AGENTS, ids=lambda card: card.name)
@pytest.mark.parametrize("foreign", ["photographer", "cil", "waypoint-pid"])
def test_another_kind_of_agents_file_is_refused_with_a_way_out(card, foreign):
    if foreign in agents.names(card.name):
        return
    with pytest.raises(
        ValueError, match=f"Expected the weights of .*{foreign}.*, got .*agent=model"
    ) as caught:
        agents.load(agents.card(foreign).path, card.name)
    assert "\n" not in str(caught.value)


def test_a_drivers_file_must_say_how_it_is_built(tmp_path):
    path = tmp_path / "mine.safetensors"
    save_file(load_file(agents.card("cil").path), path)
    with pytest.raises(
        ValueError, match=r'built as \{"branch_features": 64.*got one that does not say'
    ):
        agents.load(path, "SADA-Driving")
