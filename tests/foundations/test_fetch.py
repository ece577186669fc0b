"""Agents that others made: downloaded or handed in, checked, converted, written whole."""

import json
import os
import re
import stat
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_fetch import FILES, TOY, convert, offer, pack
from typer.testing import CliRunner

from sada_gym import agents
from sada_gym.cli import app
from sada_gym.errors import FileError, UserError
from sada_gym.foundations import fetch
from sada_gym.foundations.cards import FetchedAgent, cards
from sada_gym.foundations.lazy import load

REAL = [agent for card in cards() for agent in card.fetched]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A data folder with a space in its name."""
    place = tmp_path / "my data"
    monkeypatch.setenv(fetch.DATA_FOLDER, str(place))
    return place


@pytest.fixture
def toy(monkeypatch, folder):
    """Where the toy's file goes."""
    offer(monkeypatch)
    return folder / "toy-net.safetensors"


@pytest.fixture
def archive(tmp_path):
    return pack(tmp_path / "my toys.tgz", {"package/README.md": b"hello", **FILES})


def run(*words):
    return CliRunner().invoke(app, [*map(str, words)], env={"COLUMNS": "200"})


def test_an_archive_is_converted_and_loaded(toy, archive):
    assert fetch.fetch("toy-net", archive) == toy
    assert toy.read_bytes() == convert(FILES)
    assert [path.name for path in toy.parent.iterdir()] == [toy.name]
    assert agents.load("toy-net", "SADA-Detection") == ("toy", convert(FILES))
    agents.check_agent("toy-net", "SADA-Detection")
    fetch.fetch("toy-net", archive)  # once more


def test_a_zip_is_an_archive_as_well(toy, tmp_path):
    with zipfile.ZipFile(tmp_path / "toy.whl", "w") as wheel:
        for name, content in FILES.items():
            wheel.writestr(name, content)
    assert fetch.fetch("toy-net", tmp_path / "toy.whl").read_bytes() == convert(FILES)


@pytest.mark.parametrize("inside", ["", "models", "package/models"])
def test_a_folder_or_one_of_its_files_will_do(toy, tmp_path, inside):
    source = tmp_path / "unpacked" / inside
    source.mkdir(parents=True)
    for name, content in FILES.items():
        (source / Path(name).name).write_bytes(content)
    assert fetch.fetch("toy-net", tmp_path / "unpacked") == toy
    assert fetch.fetch("toy-net", source / "toy.bin") == toy


def test_other_files_are_refused_and_the_earlier_one_is_kept(toy, archive, tmp_path):
    fetch.fetch("toy-net", archive)
    whole = archive.read_bytes()
    cut = tmp_path / "cut.tgz"
    cut.write_bytes(whole[: len(whole) // 2])
    text = tmp_path / "text.tgz"
    text.write_text("not an archive")
    other = pack(tmp_path / "other.tgz", {**FILES, "package/models/toy.bin": b"of version 2"})
    lacking = pack(tmp_path / "lacking.tgz", {"package/models/toy.json": b'{"k": 1}'})
    empty = tmp_path / "empty"
    empty.mkdir()
    for source, wrong in (
        (cut, "got a damaged or another file"),
        (text, "got a damaged or another file"),
        (other, r"Expected package/models/toy\.bin in .*SHA-256 .*damaged or of another version"),
        (lacking, r"Expected package/models/toy\.bin in .*got no such file"),
        (empty, r"Expected package/models/toy\.json in .*got no such file"),
    ):
        with pytest.raises(FileError, match=wrong) as caught:
            fetch.fetch("toy-net", source)
        assert "Pass toys-net-1.2.3.tgz of @toys/net 1.2.3" in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(FileError, match="there is no such file or folder"):
        fetch.fetch("toy-net", tmp_path / "nowhere.tgz")
    assert toy.read_bytes() == convert(FILES)


def test_damage_anywhere_is_a_sentence(toy, archive, tmp_path):
    zipped = tmp_path / "toy.zip"
    with zipfile.ZipFile(zipped, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in FILES.items():
            packed.writestr(name, content)
    rng = np.random.default_rng(0)
    for _ in range(200):
        damaged = bytearray(rng.choice([archive, zipped]).read_bytes())
        for place in rng.integers(len(damaged), size=3):
            damaged[place] = rng.integers(256)
        (tmp_path / "damaged").write_bytes(damaged[: rng.integers(20, 2 * len(damaged))])
        found, said = None, ""
        try:
            found = fetch.package_files("toy-net", tmp_path / "damaged")
        except UserError as error:
            said = str(error)
        assert found == FILES or said
        assert "\n" not in said


def test_a_conversion_that_gives_other_bytes_writes_nothing(monkeypatch, toy, archive):
    offer(monkeypatch, replace(TOY, sha256="0" * 64))
    with pytest.raises(FileError, match=r"Expected the converted toy-net with SHA-256 000"):
        fetch.fetch("toy-net", archive)
    assert not toy.exists()


def test_an_agent_that_is_missing_or_changed_names_the_command(toy, archive):
    command = "`sada-gym fetch toy-net`"
    for ask in (agents.load, agents.check_agent):
        with pytest.raises(UserError, match=f"got no such file.* Fetch it once: {command}"):
            ask("toy-net", "SADA-Detection")
    fetch.fetch("toy-net", archive)
    toy.write_bytes(toy.read_bytes()[:-1])
    for ask in (agents.load, agents.check_agent):
        with pytest.raises(UserError, match=f"with SHA-256 .*Fetch it again: {command}"):
            ask("toy-net", "SADA-Detection")
    fetch.fetch("toy-net", archive)
    agents.check_agent("toy-net", "SADA-Detection")


def test_a_folder_that_cannot_be_written_names_the_variable(monkeypatch, tmp_path, archive):
    offer(monkeypatch)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(fetch.DATA_FOLDER, str(tmp_path / "file" / "below"))
    with pytest.raises(FileError, match=r"Expected to write .*SADA_GYM_DATA names the folder"):
        fetch.fetch("toy-net", archive)


def test_what_a_killed_run_left_is_cleared(toy, archive):
    toy.parent.mkdir()
    half = toy.parent / f".{toy.name}.tmp"
    half.write_bytes(b"half")
    with pytest.raises(UserError, match="got no such file"):
        agents.load("toy-net", "SADA-Detection")
    fetch.fetch("toy-net", archive)
    assert not half.exists()


def program(folder, text):
    """Write a program that stands for npm."""
    path = folder / "npm"
    path.write_text(f"#!{sys.executable}\n{text}")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


@pytest.fixture
def bin_folder(tmp_path, monkeypatch):
    place = tmp_path / "bin"
    place.mkdir()
    monkeypatch.setenv("PATH", str(place))
    return place


def test_no_npm_says_which_file_to_pass(toy, bin_folder):
    with pytest.raises(UserError, match=r"program npm .* got none\. Get toys-net-1\.2\.3\.tgz .*"):
        fetch.fetch("toy-net")
    result = run("fetch", "toy-net")
    assert result.exit_code == 2
    assert "`sada-gym fetch toy-net --file toys-net-1.2.3.tgz`" in result.output


@pytest.mark.skipif(os.name == "nt", reason="the program that stands for npm is a script")
def test_npm_is_asked_for_exactly_this_version(toy, bin_folder, archive):
    program(
        bin_folder,
        "import shutil, sys\n"
        "command = ['pack', '--loglevel=error', '--ignore-scripts', '@toys/net@1.2.3']\n"
        "assert sys.argv[1:] == command\n"
        f"shutil.copy({str(archive)!r}, 'toys-net-1.2.3.tgz')\n",
    )
    assert fetch.fetch("toy-net").read_bytes() == convert(FILES)


@pytest.mark.skipif(os.name == "nt", reason="the program that stands for npm is a script")
def test_what_npm_says_is_passed_on(toy, bin_folder, monkeypatch):
    said = "npm error code E404\nnpm error 404 No such version of it.\nnpm error A log: file\n"
    program(bin_folder, f"import sys\nsys.exit({said!r})\n")
    with pytest.raises(UserError, match=r"got: npm error 404 No such version of it\.\. Get toys"):
        fetch.fetch("toy-net")
    program(bin_folder, "import sys\nsys.exit(7)\n")
    with pytest.raises(UserError, match=r"got: exit code 7\. Get toys-net-1\.2\.3\.tgz"):
        fetch.fetch("toy-net")
    program(bin_folder, "pass")
    with pytest.raises(UserError, match=r"there is no such file"):
        fetch.fetch("toy-net")
    program(bin_folder, "import time\ntime.sleep(60)")
    monkeypatch.setattr(fetch, "_TIMEOUT_S", 0.2)
    with pytest.raises(UserError, match="got no answer"):
        fetch.fetch("toy-net")


def test_killed_half_way_the_earlier_file_stays(toy, archive, tmp_path):
    """The process dies between writing the new file and putting it in its place."""
    fetch.fetch("toy-net", archive)
    code = (
        "import os, signal, sys, pytest\n"
        "from pathlib import Path\n"
        "from toy_fetch import offer\n"
        "from sada_gym import fetch\n"
        "patch = pytest.MonkeyPatch()\n"
        "offer(patch)\n"
        "patch.setattr(os, 'fsync', lambda file: os.kill(os.getpid(), signal.SIGKILL))\n"
        "fetch.fetch('toy-net', Path(sys.argv[1]))\n"
    )
    paths = {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    killed = subprocess.run(
        [sys.executable, "-c", code, archive], env={**os.environ, **paths}, timeout=60
    )
    assert killed.returncode != 0
    assert toy.read_bytes() == convert(FILES)
    agents.check_agent("toy-net", "SADA-Detection")


def test_the_list(toy, archive):
    listed = run("fetch")
    assert listed.exit_code == 0
    for part in ("toy-net", "npm: @toys/net 1.2.3", "1 MB", "MIT", "not fetched", "SADA_GYM_DATA"):
        assert part in listed.output
    (row,) = json.loads(run("fetch", "--json").stdout)
    assert (row["name"], row["fetched"], row["file"]) == ("toy-net", False, str(toy))
    done = run("fetch", "toy-net", "--file", archive)
    assert done.exit_code == 0
    assert str(toy) in done.output
    assert str(toy) in run("fetch").output


def test_bad_words_are_sentences(toy, archive):
    for words, wrong in (
        (("toy-nte",), "Did you mean toy-net?"),
        (("--file", archive), "Expected a NAME with --file"),
        (("toy-net", "--file", "nowhere"), "there is no such file"),
    ):
        result = run("fetch", *words)
        assert result.exit_code == 2
        assert wrong in result.output


def test_by_default_files_go_to_the_users_folder(monkeypatch):
    for unset in ("", None):
        if unset is None:
            monkeypatch.delenv(fetch.DATA_FOLDER)
        else:
            monkeypatch.setenv(fetch.DATA_FOLDER, unset)
        assert fetch.data_folder().is_absolute()
        assert fetch.data_folder().name == "sada_gym"


@pytest.mark.parametrize("agent", REAL, ids=lambda agent: agent.name)
def test_the_cards_of_fetched_agents_are_complete(agent: FetchedAgent):
    assert callable(load(agent.converter))
    assert callable(load(agent.loader))
    assert agent.client in ("npm", "pip")
    hashes = [agent.sha256, *agent.members.values()]
    assert all(re.fullmatch("[0-9a-f]{64}", each) for each in hashes)
    assert agent.name not in {shipped.name for card in cards() for shipped in card.agents}
    assert agent.version in agent.archive
