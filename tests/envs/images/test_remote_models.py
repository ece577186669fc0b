"""Classifiers and detectors in a process of their own: the same bits, and a sentence for faults."""

from __future__ import annotations

import re
import socket
import sys
import threading
import time
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from image_toys import Halves, find_square, square, squares
from numpy.testing import assert_array_equal
from PIL import Image

import sada_gym
from sada_gym import ImageApplication
from sada_gym.errors import AgentLost, UserError
from sada_gym.testing.purity import assert_pure

pytest.importorskip("cv2")

PAGE = Path(__file__).parents[3] / "docs" / "agent-without-package.md"

SERVE = """import pathlib, sys
import numpy as np
import sada_gym
from image_toys import find_square

def model(images):
    (answer,) = find_square(images)
    pathlib.Path("asked").open("a").write(".")
    if len(pathlib.Path("asked").read_text()) > 30 and not pathlib.Path("fixed").exists():
        print('out of memory')
        sys.exit(3)
    return [answer]

sada_gym.serve(model, name="bright")
"""


def serve(model, **options):
    """Serve a model from a thread, and return its address."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    keywords = {"port": port, **options}
    threading.Thread(target=sada_gym.serve, args=(model,), kwargs=keywords, daemon=True).start()
    for _ in range(100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                break
        time.sleep(0.05)
    return f"tcp://127.0.0.1:{port}"


def detect(agent, **changed):
    images, labels = squares()
    return ImageApplication(images, agent=agent, labels=labels, batch=3, **changed)


def classify(agent, **changed):
    images = [square(10, 20), square(90, 20), square(14, 50), square(95, 60)]
    return ImageApplication(images, agent=agent, labels=[0, 1, 0, 1], batch=2, **changed)


def scored(application, n=12):
    mu = np.random.default_rng(0).uniform(-1, 1, (n, len(application.parameters)))
    with closing(application):
        return application.evaluate(mu.astype(np.float32), range(n))


@pytest.mark.parametrize(
    ("make", "model", "more"),
    [
        (detect, find_square, {}),
        (classify, Halves().eval(), {"score": "confidence"}),
        (classify, Halves().eval(), {"score": "confidence", "input_size": 64, "imagenet": True}),
    ],
    ids=["a detector", "a classifier", "a prepared classifier"],
)
def test_a_served_model_scores_as_it_does_in_this_process(make, model, more):
    served = make(serve(model, name="one"), **more)
    ours = make(model, agent_id="ours", **more)
    assert served.agent.names == ours.agent.names
    assert served.agent_name == "one"
    there, here = scored(served), scored(ours)
    assert_array_equal(there.score, here.score)
    assert len(np.unique(here.score)) > 1
    assert there.infos == here.infos
    assert_pure(served, n=3, sizes=(1, 2), other_process=False)


def test_who_serves_is_the_models_identity():
    model = Halves().eval()
    address = serve(model)
    plain = classify(address)
    assert plain.fingerprint  # the hash of the weights
    assert plain.agent_name == address.removeprefix("tcp://")
    assert plain.fingerprint != classify(address, input_size=64).fingerprint
    assert plain.fingerprint != classify(serve(model, name="one")).fingerprint
    nameless = serve(find_square)
    assert detect(nameless).fingerprint is None
    assert detect(nameless, agent_id="mine").fingerprint


def test_what_cannot_begin_gets_a_sentence():
    with pytest.raises(UserError, match="got an error: Expected task='classify' or task='detect'"):
        ImageApplication([square(20, 20)], agent=serve(find_square))
    with pytest.raises(
        UserError, match=r"Expected an agent in tcp://127.0.0.1:1, but nothing answers"
    ):
        detect("tcp://127.0.0.1:1")
    with pytest.raises(UserError, match="device= as a name for tcp://"):
        detect("tcp://127.0.0.1:1", device=3)
    if not torch.cuda.is_available():
        with pytest.raises(
            UserError, match="got an error: Expected a device that is here, got 'cu"
        ):
            classify(serve(Halves().eval()), device="cuda")


def street(folder):
    """Write images, a server that dies after some answers, and a file of both."""
    (folder / "street").mkdir()
    for i, image in enumerate(squares()[0]):
        Image.fromarray(image).save(folder / "street" / f"{i}.png")
    (folder / "serve.py").write_text(SERVE)
    (folder / "street.toml").write_text(
        'images = "street"\nagent = ["python", "serve.py"]\ntask = "detect"\nagent_timeout = 60\n'
        'batch = 2\nconditions = ["exposure", "fog"]\n'
    )
    return str(folder / "street.toml")


def refusing(_):
    raise ValueError("no such size")


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (refusing, "no such size"),
        ({"boxes": np.zeros((1, 5))}, r"boxes \(N, 4\).*got \(1, 5\)"),
        ({"scores": np.array([np.nan])}, r"scores in \[0, 1\].*nan"),
        ({"boxes": np.full((1, 4), np.inf)}, "boxes of finite numbers"),
        ({"boxes": np.array([[9, 9, 5, 20]])}, r"x0 <= x1 and y0 <= y1.*\[9.0, 9.0, 5.0, 20.0\]"),
        ({"labels": np.array([0.5])}, "whole labels"),
    ],
    ids=["raises", "shape", "NaN", "infinite", "reversed", "labels"],
)
@pytest.mark.parametrize("is_ours", [True, False], ids=["served by us", "not by us"])
def test_a_model_that_breaks_in_the_middle_ends_with_a_sentence(changed, told, is_ours):
    asked = []

    def model(images):
        asked.append(1)
        (answer,) = find_square(images)
        if len(asked) <= 8:
            return [answer]
        if callable(changed):
            return changed(images)
        whole = {"boxes": np.zeros((1, 4)), "labels": np.ones(1, int), "scores": np.ones(1)}
        return [{**whole, **changed}]

    class Unchecked:
        """A server that sends what its model tells, whatever it is."""

        task, names, fingerprint = "detect", {}, "unchecked"

        def found(self, image):
            pixels = torch.from_numpy(image).permute(2, 0, 1).float() / 255.0
            told = {key: np.asarray(value) for key, value in model([pixels])[0].items()}
            return SimpleNamespace(**told, classes=told["labels"])

    application = detect(serve(model if is_ours else Unchecked(), name="one"))
    with pytest.raises((UserError, AgentLost), match=told):
        scored(application)


@pytest.mark.parametrize("scores", [np.zeros((2, 2)), np.array([0.1, np.nan]), np.zeros(0)])
def test_a_classifier_that_answers_nonsense_gets_a_sentence(scores):
    class Unchecked:
        task, names, fingerprint = "classify", {}, "unchecked"

        def found(self, _):
            return SimpleNamespace(probabilities=scores)

    with pytest.raises(
        AgentLost, match=r"numbers from the classifier.*continue the run with --resume"
    ):
        classify(serve(Unchecked()))


@pytest.mark.long
@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_run_goes_on_when_its_model_is_there_again(workers, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", ":".join(sys.path))
    file, keywords = street(tmp_path), {"budget": 20, "samples": 10, "seed": 0}
    keywords |= {"pictures": False, "progress": False, "diagnose": False}
    with pytest.raises(AgentLost, match=r"the process died.*out of memory.*--resume"):
        sada_gym.attack(file, "random", out="run", workers=workers, **keywords)
    (tmp_path / "fixed").touch()
    run = sada_gym.attack(file, "random", out="run", resume=True, workers=workers, **keywords)
    images, _ = squares()
    ours = ImageApplication(
        images, agent=find_square, task="detect", batch=2, conditions=["exposure", "fog"],
        agent_id="ours",
    )  # fmt: skip
    whole = sada_gym.attack(ours, "random", out="whole", **keywords)
    assert_array_equal(run.samples.score, whole.samples.score)
    assert 0 < run.result.fooled < 10


def test_the_bare_program_of_the_page_serves_a_detector(bare_python, tmp_path, monkeypatch):
    monkeypatch.delenv("PYTHONPATH", raising=False)
    page = PAGE.read_text(encoding="utf-8")
    (program,) = re.findall(r"```python\n(import contextlib, json.*?)```", page, re.S)
    (look,) = re.findall(r"```python\n(import numpy as np\n\n\ndef look.*?)```", page, re.S)
    (old,) = re.findall(r"def act.*?\n(?=KINDS)", program, re.S)
    for before, after in (
        (old, look),
        ('"name": "balancer-1"', '"name": "finder-1", "task": "detect"'),
        ('== "hello":', '== "images":'),
        ('actions=act(arrays["observation"])', '**look(arrays["image"])'),
    ):
        assert before in program
        program = program.replace(before, after)
    (tmp_path / "serve.py").write_text(program)
    served = detect([bare_python, str(tmp_path / "serve.py")])
    assert served.agent_name == "finder-1"
    ours = scored(detect(find_square, agent_id="ours"))
    assert_array_equal(scored(served).score, ours.score)
