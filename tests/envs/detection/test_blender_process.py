"""Blender as a program that may be missing, old, noisy, slow or dying: a fake one plays it."""

import os
import pickle
import re
import signal
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from sada_gym import attack
from sada_gym.cli import app
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.renderers import find_renderer
from sada_gym.envs.detection.renderers.blender import Blender
from sada_gym.errors import SlowWorlds, UserError
from sada_gym.evaluation.evaluator import cost_text
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.problems import make_application
from sada_gym.oracle import Oracle

FAKE = Path(__file__).parents[2] / "support" / "fake_blender.py"
MU = np.random.default_rng(0).uniform(-1, 1, (4, 8)).astype(np.float32)


@pytest.fixture
def fake(tmp_path, monkeypatch):
    """A program `blender` in a folder whose name has a blank; returns how to make it misbehave."""
    folder = tmp_path / "my programs"
    folder.mkdir()
    program = folder / "blender"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{FAKE}" "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("SADA_GYM_BLENDER", str(program))
    monkeypatch.setenv("FAKE_BLENDER_NOTES", str(tmp_path))
    monkeypatch.setenv("FAKE_BLENDER", "")

    def misbehave(*ways):
        monkeypatch.setenv("FAKE_BLENDER", ",".join(ways))
        program.touch()  # another program: its version is asked again

    return misbehave


@pytest.fixture
def blender(fake):
    renderers = []

    def make(*ways, **keywords):
        fake(*ways)
        renderers.append(Blender(**keywords))
        return renderers[-1]

    yield make
    for renderer in renderers:
        renderer.close()


def scenes(count=2):
    application = DetectionApplication("car")
    return [application.scene(MU[i], i + 1) for i in range(count)]


def pids(tmp_path):
    return [int(path.name[4:]) for path in tmp_path.glob("pid-*")]


def gone(pid, seconds=10.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z" and os.getppid() != pid and not _is_ours(pid):
            return True  # the machine's own first process has not collected it yet
        time.sleep(0.05)
    return False


def _is_ours(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1] == str(
            os.getpid()
        )
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.parametrize("ways", [(), ("rubbish",), ("dies-once",)])
def test_pictures_come_back_in_order(blender, ways, tmp_path):
    renderer = blender(*ways)
    first, second = renderer.render_batch(scenes(), 48)
    assert np.unique(first.image).tolist() == [1]
    assert np.unique(second.image).tolist() == [2]
    flat = find_renderer("rasteriser").render(scenes()[0], 48)
    np.testing.assert_array_equal(first.mask, flat.mask)
    np.testing.assert_array_equal(first.box, flat.box)
    assert len(pids(tmp_path)) == (2 if ways == ("dies-once",) else 1)


@pytest.mark.parametrize(
    ("ways", "message", "drawn"),
    [
        (("dies",), r"Blender 4\.2\.1 .*died twice: .*code 11.*Segmentation fault, they say", 2),
        (("dies-halfway",), r"Expected a picture from Blender .*died twice", 2),
        (("fails",), r"Blender could not draw a scene: .*No space left on device", 1),
        (("truncates",), r"Expected a picture of 48 pixels .*from Blender", 1),
        (("hangs",), r"within 0\.5 s.*SADA_GYM_BLENDER_TIMEOUT_S to more seconds", 1),
        (("no-cycles",), r"Blender could not .*\"CYCLES\" not found", 0),
    ],
)
def test_a_blender_that_fails_is_one_sentence(blender, ways, message, drawn, tmp_path):
    renderer = blender(*ways, timeout_s=0.5 if "hangs" in ways else None)
    with pytest.raises(UserError, match=message) as caught:
        renderer.render_batch(scenes(), 48)
    assert "\n" not in str(caught.value)
    notes = tmp_path / "drawn"
    assert (len(notes.read_text().split()) if notes.exists() else 0) == drawn
    renderer.close()
    assert all(gone(pid) for pid in pids(tmp_path))


def test_after_a_failure_the_next_picture_starts_it_again(blender, fake):
    renderer = blender("dies")
    with pytest.raises(UserError, match="died twice"):
        renderer.render(scenes()[0], 48)
    fake()
    assert renderer.render(scenes()[1], 48).image.max() == 2


@pytest.mark.parametrize(
    ("ways", "message"),
    [
        (("old",), r"Expected Blender 3\.3 or newer, got Blender 2\.79 at .*SADA_GYM_BLENDER"),
        (("mute",), r"--version` to print Blender's version, got ''.*apt-get install blender"),
    ],
)
def test_a_program_that_does_not_do_is_refused_at_once(fake, ways, message):
    fake(*ways)
    with pytest.raises(UserError, match=message):
        make_application("SADA-Detection-v0", renderer="blender")


def test_a_missing_blender_is_told_with_the_line_that_installs_it(monkeypatch, tmp_path):
    monkeypatch.setenv("SADA_GYM_BLENDER", str(tmp_path / "none"))
    with pytest.raises(UserError, match=r"Blender at '.*none', got none\. .*apt-get install"):
        Blender()
    monkeypatch.delenv("SADA_GYM_BLENDER")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserError, match=r"Blender on the PATH, got none\. .*SADA_GYM_BLENDER"):
        Blender()


@pytest.mark.parametrize(
    ("variable", "value", "message"),
    [
        ("SADA_GYM_BLENDER_SAMPLES", "many", r"SAMPLES to be a number above 0, got 'many'"),
        ("SADA_GYM_BLENDER_SAMPLES", "5000", r"samples of at most 4,096, got 5,000"),
        ("SADA_GYM_BLENDER_TIMEOUT_S", "-1", r"TIMEOUT_S to be a number above 0, got '-1'"),
    ],
)
def test_options_by_environment_variables_are_checked(fake, monkeypatch, variable, value, message):
    monkeypatch.setenv(variable, value)
    with pytest.raises(UserError, match=message):
        Blender()


def test_the_identity_tells_versions_and_samples_apart(blender, monkeypatch):
    few, many = blender(samples=4), blender(samples=64)
    assert len({few.key, many.key}) == 2
    monkeypatch.setenv("SADA_GYM_BLENDER_SAMPLES", "4")
    assert blender().key == few.key
    assert '"blender": "4.2.1"' in few.identity


@pytest.mark.long
def test_workers_start_a_blender_each_and_end_it(fake, tmp_path):
    scores = []
    for workers in (1, 2):
        with Oracle(
            "SADA-Detection-v0",
            env_kwargs={"renderer": "blender"},
            budget=4,
            seed=0,
            workers=Workers(workers, chunk_size=2),
        ) as oracle:
            scores.append(oracle(MU))
    np.testing.assert_array_equal(*scores)
    assert all(gone(pid) for pid in pids(tmp_path))


def test_a_copy_has_a_blender_of_its_own(blender, tmp_path):
    renderer = blender()
    renderer.render(scenes()[0], 48)
    copy = pickle.loads(pickle.dumps(renderer))
    assert copy.render(scenes()[1], 48).image.max() == 2
    copy.close()
    assert renderer.render(scenes()[0], 48).image.max() == 1
    assert len(pids(tmp_path)) == 2


def test_a_fork_leaves_its_parents_blender_alone(blender, tmp_path):
    renderer = blender()
    renderer.render(scenes()[0], 48)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            status = 0 if renderer.render(scenes()[1], 48).image.max() == 2 else 2
            renderer.close()
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert renderer.render(scenes()[0], 48).image.max() == 1
    assert len(pids(tmp_path)) == 2


def test_threads_take_turns(blender):
    renderer, wrong = blender(), []

    def draw(number):
        for _ in range(5):
            if renderer.render(scenes()[number], 48).image.max() != number + 1:
                wrong.append(number)

    threads = [threading.Thread(target=draw, args=(number,)) for number in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


PARENT = """
import sys, time
import numpy as np
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.renderers.blender import Blender
application = DetectionApplication("car", renderer=Blender())
application.observation(np.zeros(8), 1)
print("drawn", flush=True)
time.sleep(60)
"""


@pytest.mark.long
@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGKILL])
def test_blender_goes_with_its_parent(fake, tmp_path, sign):
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True)
    assert parent.stdout.readline() == "drawn\n"
    parent.send_signal(sign)
    parent.wait()
    parent.stdout.close()
    (pid,) = pids(tmp_path)
    assert gone(pid)


def test_the_cost_of_a_run_is_told_before_it_starts(fake, tmp_path, monkeypatch):
    monkeypatch.setattr("sada_gym.evaluation.evaluator.SLOW_S", 0.0)
    given = {"out": tmp_path / "run", "budget": 4, "samples": 3, "pictures": False}
    with pytest.warns(SlowWorlds, match=r"About .* s a world; 7 worlds: \d+ s\.$"):
        attack("SADA-Detection-v0", "random", env_kwargs={"renderer": "blender"}, **given)
    with warnings.catch_warnings():
        warnings.simplefilter("error", SlowWorlds)
        attack("SADA-Detection-v0", "random", **given | {"out": tmp_path / "fast"})


@pytest.mark.parametrize(
    ("seconds", "worlds", "workers", "text"),
    [
        (3.12, 250, 1, "About 3.1 s a world; 250 worlds: 13 minutes."),
        (5.0, 10_000, 2, "About 5 s a world; 10,000 worlds: 7 hours by 2 workers."),
        (4.0, 5, 1, "About 4 s a world; 5 worlds: 20 s."),
    ],
)
def test_costs_are_told_in_the_unit_that_fits(seconds, worlds, workers, text):
    assert cost_text(seconds, worlds, workers) == text


def test_the_command_line_tells_the_cost_in_a_line(fake, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sada_gym.evaluation.evaluator.SLOW_S", 0.0)
    command = [*("attack", "SADA-Detection-Car-v0", "-a", "random"), "--budget", "2"]
    command += ["--samples", "2", "--workers", "1", "--out", str(tmp_path / "run")]
    result = CliRunner().invoke(app, [*command, "--env-kwargs", "renderer=blender"])
    assert result.exit_code == 0, result.output
    said = result.output + capsys.readouterr().err
    assert len(re.findall(r"^About \S+ s a world; 4 worlds: \d+ s\.$", said, re.MULTILINE)) == 1
