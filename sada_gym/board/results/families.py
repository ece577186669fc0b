"""Families of adversaries, which all charts draw alike."""

from __future__ import annotations

from dataclasses import dataclass

from sada_gym.foundations.frames import BLUE


@dataclass(frozen=True)
class Family:
    """Adversaries that charts draw alike.

    Attributes:
        name: What the legend calls them.
        colour: Their colour; all are distinct for colour-blind readers too (Okabe and Ito 2008).
        marker: Their mark as Matplotlib names it, which tells them apart without any colour.
        members: Their labels.
    """

    name: str
    colour: str
    marker: str
    members: frozenset[str] = frozenset()


FAMILIES = (
    Family("controls", "#6b7785", "s", frozenset({"ideal", "memorise"})),
    Family(
        "the paper's baselines",
        BLUE,
        "o",
        frozenset({"random", "svm", "gp", "gaussian", "gmm10", "gmm50", "bayesian"}),
    ),
    Family(
        "BBGAN",
        "#b84a00",
        "^",
        frozenset({"bbgan", "bbgan (paper)", "bbgan-boost", "bbgan-boost (paper)"}),
    ),
    Family("RL", "#a4447c", "D", frozenset({"reinforce", "ppo", "sac", "td3"})),
    Family("other methods", "#00795a", "v"),
)


def family_of(label: str) -> Family:
    """Return the family of an adversary by its label."""
    return next((family for family in FAMILIES if label in family.members), FAMILIES[-1])
