"""Whatever a name holds: it is refused before anything is evaluated, or goes through all steps."""

from __future__ import annotations

import io
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from made_board import CARDS, Made, make_entries

from leaderboard.site import build_site
from sada_gym import GymnasiumApplication, attack
from sada_gym.analyses.regression.export import export
from sada_gym.analyses.regression.junit import junit, markdown
from sada_gym.analyses.regression.regress import regress
from sada_gym.analyses.report.make import report
from sada_gym.cli.console import PlainConsole, say
from sada_gym.envs.wrapped import Keyword
from sada_gym.errors import UserError, is_plain, plain

OBEYED = {
    "line break": "..#\n#..",
    "carriage return": "safe\rgone",
    "tab": "a\tb",
    "escape": "\x1b[31mred\x1b[0m",
    "bell": "ding\x07",
    "nul": "a\x00b",
    "next line": "a\x85b",
    "line separator": "a\u2028b",
    "paragraph separator": "a\u2029b",
    "right to left": "\u202etxt.exe",
    "isolate": "\u2066a\u2069b",
    "not UTF-8": "caf\udce9",
    "half an emoji": "\ud83d",
    "surrogates in the wrong order": "\udc00\ud800",
}
PLAIN = {
    "family": "\N{MAN}\N{ZERO WIDTH JOINER}\N{PERSONAL COMPUTER}",
    "flag": "\N{WAVING BLACK FLAG}\U000e0067\U000e0062\U000e007f",
    "no-break space": "10\u00a0km/h",
    "thin space": "1\u2009000",
    "byte order mark": "\ufeffa",
    "zero width": "a\u200bb",
    "marks": "e" + "\u0301" * 20,
    "Arabic": "\u0637\u0631\u064a\u0642",
    "Hebrew": "\u05d3\u05e8\u05da\u200f",
    "Japanese": "\u9053\u8def",
    "tag": "<script>alert(1)</script>",
    "entity": "a &amp; b",
    "quotes": "\"a\" 'b'",
    "SQL": "'; DROP TABLE evaluations; --",
    "mathtext": "$\\frac{1}{0}$",
    "dollar": "5 $",
    "per cent": "100 % %s %n",
    "braces": "{0} {name}",
    "formula": "=1+1",
    "option": "-rf",
    "markup": "[bold]a[/] [/b]",
    "Windows": "C:\\temp\\new",
    "device": "CON",
    "commas": "a,b;c",
    "table": "`a` | b",
    "None": "None",
    "nan": "nan",
    "space": " ",
    "hash": "a#b",
    "long": "x" * 100,
    "column": "score",
}
"""All but these are refused as the name of a parameter or an agent."""


class Road(gym.Env):
    """A car gets through where it is dry, and the simulator breaks where it is fast."""

    observation_space, action_space = spaces.Box(-1, 1, (1,)), spaces.Discrete(2)

    def __init__(self, surface="dry", speed=0.0, words=""):
        self.surface, self.speed, self.words = surface, speed, words

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        if self.speed > 0.9:
            raise OSError(self.words)
        info = {"ending": self.words}
        return np.zeros(1, np.float32), float(self.surface == "dry"), True, False, info


def road(choice, *, speed="speed", agent_id="a", unit=""):
    return GymnasiumApplication(
        Road,
        agent=lambda seen: 0,
        agent_id=agent_id,
        parameters={
            "surface": Keyword(choices=("dry", choice)),
            speed: Keyword(0.0, 1.0, name="speed", unit=unit),
        },
        env_kwargs={"words": choice},
        score=("return", 0, 1),
        fooling_threshold=0.5,
        max_steps="own",
    )


def through_all_steps(application, name, folder):
    """Attack, report, export and regress; return the texts of what is written."""
    run = folder / re.sub("[/\0\ud800-\udc7f]", "_", name)[:60]
    result = attack(
        application, "random", budget=30, samples=20, out=run, progress=False, pictures=False
    )
    assert result.result.invalid is not None
    page = report(run, out=folder / "page.html", application=application)
    suite = export(run, folder / "suite", application=application, confirm=0).path
    again = regress(suite, application)
    assert again.exit_code == 0
    (folder / "a.md").write_text(markdown(again), encoding="utf-8")
    (folder / "a.xml").write_bytes(junit(again))
    console = PlainConsole(file=io.StringIO(), width=500)
    say(repr(result), console=console)
    console.print(name, markup=False)
    written = [page, suite, folder / "a.md", folder / "a.xml", *run.glob("*.[jc]s*")]
    return [console.file.getvalue(), *(path.read_text(encoding="utf-8") for path in written)]


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", [*OBEYED.values(), *PLAIN.values()], ids=[*OBEYED, *PLAIN])
def test_a_name_goes_through_all_steps(name, tmp_path):
    names = {"speed": name, "agent_id": name, "unit": name} if name in PLAIN.values() else {}
    for text in through_all_steps(road(name, **names), name, tmp_path):
        for line in text.replace("\r\n", "\n").split("\n"):
            assert is_plain(line.replace("\t", "")), ascii(line)[:300]


@pytest.mark.parametrize("name", OBEYED.values(), ids=OBEYED)
@pytest.mark.parametrize("place", ["speed", "agent_id", "unit"])
def test_what_a_terminal_obeys_is_no_name(name, place):
    with pytest.raises(UserError, match="in one line, without control characters"):
        road("wet", **{place: name})


def test_a_board_shows_plain_names_and_refuses_others(tmp_path, monkeypatch):
    monkeypatch.setattr("leaderboard.board.cards", lambda: CARDS)
    made = [Made(f"entry-{i}", 0.5, title) for i, title in enumerate(PLAIN.values())]
    entries = make_entries(tmp_path / "entries", tuple(made[:12:3]))
    build_site(entries, tmp_path / "site", pictures=False)
    pages = "".join(path.read_text(encoding="utf-8") for path in tmp_path.rglob("*.html"))
    assert "<script>alert" not in pages
    for name in OBEYED.values():
        with pytest.raises(ValueError, match="title"):
            make_entries(tmp_path / plain(name).replace("\\", "-"), (Made("a", 0.5, name),))
