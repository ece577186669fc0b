"""Draw docs/images/own-agent.png and measure the table of docs/appendix-own-agent.md.

    OMP_NUM_THREADS=1 python -m tools.draw_own_agent

It attacks the agents of examples/cartpole.py and examples/lunar_lander.py, which it trains first if
need be, and prints the table. Runs are kept in runs/own-agent, so that it goes on where it was.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from scipy.spatial import KDTree
from stable_baselines3 import PPO

from sada_gym import GymnasiumApplication, Run, attack
from sada_gym.analyses.plots.style import axis_label, new_figure, png, tidy
from sada_gym.envs.wrapped import Keyword
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK, Frame
from studies.without_hits import without_hits

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "examples"))

import cartpole  # noqa: E402
import lunar_lander  # noqa: E402

OUT = ROOT / "docs" / "images" / "own-agent.png"
RUNS = Path("runs/own-agent")
ADVERSARIES = ("random", "gp", "bbgan", "level-set")
BUDGET, SAMPLES, SEED = 1_000, 100, 0
CELLS, NEIGHBOURS = 64, 40
COLOURS = LinearSegmentedColormap.from_list("q", ["#cfe0ec", "#f6ead9", "#d9653b"])


def applications() -> dict[str, GymnasiumApplication]:
    """The applications of the two examples, by the heading in the table."""
    RUNS.mkdir(parents=True, exist_ok=True)
    balancer = RUNS / "cartpole.zip"
    if not balancer.exists():
        cartpole.train().save(balancer)
    if not lunar_lander.ZIP.exists():
        lunar_lander.train()
    return {
        "CartPole": cartpole.make_application(PPO.load(balancer)),
        "LunarLander": lunar_lander.make_application(),
    }


def run(
    title: str, application: GymnasiumApplication, adversary: str, samples: int = SAMPLES
) -> tuple[Run, float]:
    """Attack an application; also give the seconds of one processor, 0 for what was done before."""
    began = time.process_time()
    attacked = attack(
        application,
        adversary,
        budget=BUDGET,
        samples=samples,
        seed=SEED,
        options=without_hits(adversary),
        out=RUNS / f"{title}-{adversary}",
        resume=True,
    )
    return attacked, time.process_time() - began


def print_table(title: str, application: GymnasiumApplication) -> None:
    """Attack by each adversary, and print their rows."""
    for adversary in ADVERSARIES:
        attacked, seconds = run(title, application, adversary)
        report = attacked.result
        low, high = (f"{100 * end:.0f}" for end in report.afr_interval_95)
        row = (title, f"`{adversary}`", f"{100 * report.afr:.0f} ({low} to {high})")
        print(f"| {' | '.join(row)} | {report.mu_std:.2f} | {seconds:.0f} |", flush=True)
        if adversary == "bbgan":  # its training queries are uniform
            print(f"{100 * (report.search.fooling_rate or 0.0):.1f} % of {BUDGET:,} uniform worlds")


def two_parameters() -> GymnasiumApplication:
    """The lander in gravity and wind alone, as at the top of the page."""
    return GymnasiumApplication(
        "LunarLander-v3",
        agent=lunar_lander.ZIP,
        env_kwargs={"enable_wind": True},
        parameters={"gravity": Keyword(-11.9, -4.0, unit="m/s²"), "wind_power": (0.0, 20.0)},
        score=("return", -300.0, 300.0),
        fooling_threshold=0.5,
    )


def draw_map(axes: Axes, application: GymnasiumApplication, worlds: Evaluations) -> None:
    """The share of the nearest worlds that fool the agent, and the worlds themselves."""
    x, y = application.parameters.parameters
    middles = (np.arange(CELLS) + 0.5) / CELLS * 2.0 - 1.0
    grid = np.stack([one.ravel() for one in np.meshgrid(middles, middles)], axis=1)
    fooled = worlds.fooled(application.fooling_threshold)
    _, nearest = KDTree(worlds.mu).query(grid, k=NEIGHBOURS)
    share = fooled[nearest].mean(axis=1).reshape(CELLS, CELLS)
    extent = (x.low, x.high, y.low, y.high)
    image = axes.imshow(
        100.0 * share, origin="lower", extent=extent, aspect="auto", cmap=COLOURS, vmin=0, vmax=60
    )
    values = application.parameters.physical(worlds.mu)
    for which, colour, name in (
        (~fooled, "#35607f", "lands"),
        (fooled, "#7a1f0b", "does not land"),
    ):
        axes.scatter(*values[which].T, s=5, color=colour, linewidths=0, label=name)
    axes.legend(loc="lower left", fontsize=8, markerscale=2.5)
    axes.set(xlabel=axis_label(x), ylabel=axis_label(y), xlim=extent[:2], ylim=extent[2:])
    tidy(axes)
    bar = axes.figure.colorbar(image, ax=axes, shrink=0.7, pad=0.02)
    bar.set_label("worlds that fool the agent (%)", color=INK)


def draw_world(axes: Axes, frame: Frame, caption: str) -> None:
    """The last moment of an episode."""
    axes.imshow(frame)
    axes.set_title(caption, fontsize=9, color=INK)
    axes.axis("off")


@own_style()
def picture(application: GymnasiumApplication, worlds: Evaluations) -> Figure:
    """The map, and beside it a landing and a failure in the strongest wind."""
    figure = new_figure(9, 4.2)
    grid = figure.add_gridspec(2, 2, width_ratios=[2.2, 1])
    draw_map(large := figure.add_subplot(grid[:, 0]), application, worlds)
    fooled = np.flatnonzero(worlds.fooled(application.fooling_threshold))
    landed = np.flatnonzero(~worlds.fooled(application.fooling_threshold))
    wind = worlds.mu[:, 1]
    shown = (landed[wind[landed].argmin()], fooled[wind[fooled].argmax()])
    for row, (letter, i) in enumerate(zip("AB", shown, strict=True)):
        mu, seed = worlds.mu[i], int(worlds.seed[i])
        gravity, power = application.parameters.physical(mu)
        said = f"{letter}: gravity {gravity:.1f} m/s², wind {power:.1f}\nQ = {worlds.score[i]:.2f}"
        draw_world(figure.add_subplot(grid[row, 1]), application.render(mu, seed), said)
        box = {"facecolor": "white", "edgecolor": INK, "boxstyle": "circle,pad=0.2"}
        large.text(gravity, power, letter, ha="center", va="center", fontsize=9, bbox=box)
    return figure


def main() -> None:
    """Measure the table, and draw the picture."""
    for title, application in applications().items():
        print_table(title, application)
    application = two_parameters()
    uniform = run("map", application, "random", samples=BUDGET)[0].samples
    OUT.write_bytes(png(picture(application, uniform)))


if __name__ == "__main__":
    main()
