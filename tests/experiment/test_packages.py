import json
import os
import subprocess
import sys
from importlib.metadata import version

import numpy as np
import pytest
from toy import Greedy, Toy

from sada_gym import adversaries, attack
from sada_gym.adversaries.bbgan import BBGAN
from sada_gym.adversaries.random import Random
from sada_gym.evaluation.problems import make_application
from sada_gym.experiment import packages as module
from sada_gym.experiment.ideal import Ideal
from sada_gym.experiment.packages import in_order, packages
from sada_gym.foundations.cards import cards, find_card


def test_only_what_the_run_loads_counts():
    application = make_application("SADA-Analytic-v0")
    versions = packages(application, Random)
    assert list(versions) == ["python", "sada_gym", "gymnasium", "numpy", "scipy", "arithmetic"]
    assert versions["numpy"] == np.__version__
    assert packages(application, type(adversaries.make("svm", 2)))["scikit-learn"]


def test_every_adversary_and_application_of_ours_has_its_row():
    kinds = [Ideal, *map(adversaries.find, adversaries.names())]
    of_applications = [card.packages for card in cards()]
    rows = [*(kind.packages for kind in kinds), *of_applications, module._EVERY_RUN]
    assert {name for row in rows for name in row} <= set(module._ORDER)


def test_a_package_that_the_run_never_loads_does_not_refuse_to_resume(tmp_path, monkeypatch):
    def start(resume):
        return attack(
            "SADA-Analytic-v0", "random", samples=5, out=tmp_path, resume=resume, pictures=False
        )

    start(resume=False)
    monkeypatch.setattr(module, "version", lambda name: "99" if name == "pymunk" else version(name))
    start(resume=True)
    monkeypatch.setattr(module, "version", lambda name: "99" if name == "numpy" else version(name))
    with pytest.raises(ValueError, match=r"packages.numpy was '\S+' and is '99'"):
        start(resume=True)


def test_a_class_of_ones_own_may_name_its_packages():
    class Own(Toy):
        packages = ("rich",)

    class OwnGreedy(Greedy):
        packages = ()

    versions = packages(Own(), OwnGreedy)
    assert list(versions) == [
        "python",
        "sada_gym",
        "gymnasium",
        "numpy",
        "scipy",
        "arithmetic",
        "rich",
    ]
    assert "torch" in packages(Toy(), OwnGreedy)  # nothing is known of it: all may count


def test_a_class_of_ones_own_does_not_inherit_the_packages_of_ours():
    class Deeper(BBGAN):
        name = "deeper"

    class Declared(Deeper):
        packages = ("torch", "rich")

    application = make_application("SADA-Analytic-v0")
    assert "pybullet" in packages(application, Deeper)
    versions = packages(application, type("Heir", (Declared,), {"__module__": Declared.__module__}))
    assert {"torch", "rich"} <= set(versions)
    assert "pybullet" not in versions


def test_versions_have_one_order():
    versions = {"b": "1", "pillow": "2", "a": "3", "python": "4", "numpy": "5"}
    assert list(in_order(versions)) == ["python", "numpy", "pillow", "a", "b"]
    assert in_order(versions) == versions


LOADED = """
import json, sys
from importlib.metadata import packages_distributions
import numpy as np
from sada_gym import adversaries
from sada_gym.oracle import Oracle
from sada_gym.evaluation.problems import make_application
what = sys.argv[1]
if what.startswith("SADA"):
    application = make_application(what)
    application.evaluate(np.zeros((1, len(application.parameters)), np.float32), [0])
else:
    adversary = adversaries.make(what, 2, seed=0)
    q = lambda mu: (mu**2).mean(axis=1) / 2
    adversary.train(Oracle(q, dimension=2, threshold=0.1, budget=60))
    adversary.sample(3)
known = packages_distributions()
print(json.dumps(sorted({n for m in sys.modules for n in known.get(m.partition(".")[0], ())})))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "what",
    [
        "SADA-Detection-Car-v0",
        "SADA-Driving-Straight-v0",
        "SADA-UAV-3Anchors-v0",
        *(name for name in adversaries.names() if name != "cma-mae"),
    ],
)
def test_what_a_run_loads_is_declared(what):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    loaded = subprocess.run(
        [sys.executable, "-c", LOADED, what],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    modules = {name.lower() for name in json.loads(loaded.stdout.splitlines()[-1])}
    if what.startswith("SADA"):
        application = make_application(what)
        declared = find_card(application.name).packages
    else:
        declared = adversaries.find(what).packages
    counted = {*module._EVERY_RUN, *declared}
    assert {name for name in module._ORDER if name in modules} <= counted
