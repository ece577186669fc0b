"""Agents inside packages of others: checked before they are loaded."""

import hashlib
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest
from toy_parts import as_loaded

from sada_gym import agents
from sada_gym.agents.packaged import missing_packages, package_files
from sada_gym.errors import MissingPart
from sada_gym.foundations.cards import PackagedAgent, find_card

MEMBER = "numpy/version.py"


@pytest.fixture
def agent():
    import numpy

    sha256 = hashlib.sha256(Path(numpy.version.__file__).read_bytes()).hexdigest()
    here = version("numpy")
    loader = f"{as_loaded.__module__}:as_loaded"
    return PackagedAgent("numbers", "numpy", here, {MEMBER: sha256}, loader, "", "", "BSD")


def test_an_agent_of_a_package_is_loaded_from_its_files(agent, monkeypatch):
    own = replace(find_card("SADA-Digits"), packaged=(agent,))
    monkeypatch.setattr(agents, "cards", lambda: (own,))
    monkeypatch.setattr(agents, "find_card", lambda name: own)
    assert agents.names() == ("numbers", "cnn")
    how, files = agents.load("numbers", "SADA-Digits")
    assert how == "loaded"
    assert files[MEMBER].read_bytes()


def test_another_version_or_other_files_are_refused(agent):
    with pytest.raises(MissingPart, match=r"the package numpy 0\.1, got .*\.\[zoo\]'$"):
        package_files(replace(agent, version="0.1"))
    with pytest.raises(MissingPart, match=r"with SHA-256 000.*numbers would be another agent"):
        package_files(replace(agent, members={MEMBER: "0" * 64}))
    with pytest.raises(MissingPart, match=r"got no such fil.*--no-deps numpy=="):
        package_files(replace(agent, members={"numpy/none.npz": "0" * 64}))


def test_missing_packages_are_told_in_one_sentence():
    assert missing_packages({"numpy": "", "scipy": version("scipy")}) == ""
    told = missing_packages({"numpy": "", "no-such-1": "2.0", "no-such-2": ""}, "on Linux")
    assert told.startswith("Expected the packages no-such-1 2.0 and no-such-2, got none and none. ")
    assert told.endswith("'.[zoo]' (on Linux)")


def test_an_application_without_files_of_weights_takes_names_and_agents(agent, monkeypatch):
    own = replace(find_card("SADA-Digits"), packaged=(agent,), agents=(), agent_loader="")
    monkeypatch.setattr(agents, "cards", lambda: (own,))
    monkeypatch.setattr(agents, "find_card", lambda name: own)
    assert agents.load("numbers", "SADA-Digits")[0] == "loaded"
    for wrong in ("nubers", "weights.safetensors", __file__):
        with pytest.raises(ValueError, match="name among numbers, or the classifier itself, got"):
            agents.load(wrong, "SADA-Digits")
