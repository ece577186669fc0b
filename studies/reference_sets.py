"""Reference sets: where each agent is fooled, from a dense sample that no adversary trains on.

    python -m studies.reference_sets --workers 2

Every track's Sobol points are evaluated on several seeds each. All agents look at the same worlds,
so a world is drawn once for all of them. What was done is kept in `--work`, block by block, and a
second call goes on where the first was stopped; finished sets go into the package.
"""

from __future__ import annotations

import argparse
import functools
import io
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from sada_gym import agents
from sada_gym.application import Application
from sada_gym.envs.detection.renderers import Renderer, Rendering, default_renderer
from sada_gym.envs.detection.scene import Scene
from sada_gym.evaluation.problems import make_application
from sada_gym.foundations.cards import ApplicationCard, find_card
from sada_gym.foundations.files import write_file
from sada_gym.foundations.registration import tracks
from sada_gym.measures.reference import FOLDER, reference_mu, reference_seeds, write_reference

BLOCK = 500
CHUNK = 112


class SharedRenderer(Renderer):
    """Hands the pictures that one application asked for to the next, which asks for the same."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._renderings: list[Rendering] = []

    @property
    def identity(self) -> str | None:
        return self._renderer.identity

    def render_batch(self, scenes: Sequence[Scene], image_size: int) -> list[Rendering]:
        if not self._renderings:
            self._renderings = self._renderer.render_batch(scenes, image_size)
        return self._renderings

    def forget(self) -> None:
        self._renderings = []


@functools.cache
def shared_renderer() -> SharedRenderer:
    return SharedRenderer(default_renderer())


@functools.cache
def application(track: str, agent: str) -> Application:
    shared = {"renderer": shared_renderer()} if track.startswith("SADA-Detection") else {}
    return make_application(track, agent=agent, **shared)


def card_of(name: str) -> ApplicationCard:
    card = find_card(name)
    assert card is not None
    return card


def evaluate_block(track: str, names: Sequence[str], block: int, path: Path) -> None:
    """Write the scores of a block of points, (agents, points, seeds)."""
    applications = [application(track, name) for name in names]
    card = card_of(applications[0].name)
    seeds = card.reference_seeds
    rows = range(block * BLOCK, min((block + 1) * BLOCK, card.reference_points))
    mu = reference_mu(len(applications[0].parameters), card.reference_points, card.sobol_seed)
    pairs = [(row, seed) for row in rows for seed in reference_seeds(row, seeds)]
    scores: list[list[np.ndarray]] = [[] for _ in names]
    for start in range(0, len(pairs), CHUNK):
        chunk = pairs[start : start + CHUNK]
        batch = mu[[row for row, _ in chunk]]
        shared_renderer().forget()
        for of_agent, attacked in zip(scores, applications, strict=True):
            of_agent.append(attacked.evaluate(batch, [seed for _, seed in chunk]).score)
    buffer = io.BytesIO()
    np.save(buffer, np.array([np.concatenate(s).reshape(len(rows), seeds) for s in scores]))
    write_file(path, buffer.getvalue())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tracks", nargs="*", default=list(tracks(installed=True)))
    parser.add_argument("--agents", nargs="*", help="of the tracks' applications; all by default")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--work", type=Path, default=Path("runs/reference-sets"))
    parser.add_argument("--out", type=Path, default=FOLDER)
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as pool:
        for track in arguments.tracks:
            attacked = make_application(track)
            card = card_of(attacked.name)
            blocks = -(-card.reference_points // BLOCK)
            # an agent that has to be fetched is no name of the application's
            known = agents.names(attacked.name) or (attacked.agent_name,)
            names = tuple(n for n in known if arguments.agents is None or n in arguments.agents)
            stem = f"{track}-{'-'.join(names)}"
            paths = [arguments.work / f"{stem}-{i}.npy" for i in range(blocks)]
            missing = [i for i, path in enumerate(paths) if not path.exists()]
            started = time.monotonic()
            futures = [pool.submit(evaluate_block, track, names, i, paths[i]) for i in missing]
            for done, future in enumerate(as_completed(futures), start=1):
                future.result()
                spent = time.monotonic() - started
                print(f"{track}: block {done} of {len(missing)}, {spent:.0f} s", flush=True)
            scores = np.concatenate([np.load(path) for path in paths], axis=1)
            for agent, of_agent in zip(names, scores, strict=True):
                write_reference(
                    arguments.out,
                    track,
                    make_application(track, agent=agent),
                    of_agent,
                    sobol_seed=card.sobol_seed,
                )


if __name__ == "__main__":
    main()
