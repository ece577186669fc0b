"""Short attacks on the toy application."""

from toy import Greedy, Toy

from sada_gym import attack

SETTINGS = {"budget": 100, "samples": 30, "seed": 3, "pictures": False}


def run(out, problem=None, adversary=Greedy, **settings):
    return attack(problem or Toy(), adversary, out=out, **{**SETTINGS, **settings})


def contents(folder):
    """Return all files but the store, whose bytes depend on the order in which chunks came."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "run.sqlite"
    }
