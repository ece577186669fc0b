"""The key of a stored score holds the code of a user's own."""

from __future__ import annotations

import sys

import pytest
from gymnasium import spec
from gymnasium.envs.classic_control import CartPoleEnv

from sada_gym.evaluation.sources import own_sources

FILES = {
    "own_physics.py": "GRAVITY = 9.8\ndef unused(): return 1\n",
    "own_world.py": """
from own_physics import GRAVITY
LIMIT = 1.0
class Base:
    def height(self): return LIMIT
class World(Base):
    def step(self): return self.height() * GRAVITY  # metres
class Other: pass
if __name__ == "__main__":
    print(World())
""",
}


@pytest.fixture
def world(tmp_path, monkeypatch):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
        monkeypatch.delitem(sys.modules, name.removesuffix(".py"), raising=False)
    monkeypatch.syspath_prepend(str(tmp_path))
    import own_world

    return own_world.World


@pytest.mark.parametrize(
    ("file", "old", "new", "changed"),
    [
        ("own_world.py", "* GRAVITY", "+ GRAVITY", "own_world.py"),
        ("own_world.py", "LIMIT = 1.0", "LIMIT = 2.0", "own_world.py"),
        ("own_world.py", "return LIMIT", "return 2 * LIMIT", "own_world.py"),
        ("own_physics.py", "9.8", "9.81", "own_physics.py"),
        ("own_world.py", "# metres", "# feet", None),
        ("own_world.py", "Other: pass", "Other: x = 1", None),
        ("own_world.py", "print(World())", "print(World().step())", None),
        ("own_physics.py", "return 1", "return 2", None),
    ],
)
def test_what_decides_a_score_changes_the_hash(tmp_path, world, file, old, new, changed):
    before = own_sources([world])
    assert [*before] == ["own_physics.py", "own_world.py"]
    (tmp_path / file).write_text(FILES[file].replace(old, new))
    after = own_sources([world()])  # an object has its class's code
    assert [name for name in before if before[name] != after[name]] == [changed] * bool(changed)


def test_installed_code_has_no_hash():
    assert own_sources([CartPoleEnv, len, 3, spec]) == {}
