"""The perception learns from the reference's flights and its own, by DAgger (Ross et al. 2011).

Drones fly in lockstep over mild tracks, in the first round told the truth about the next gate, in
the later ones more and more what the network sees. The truth is written down at every step, and the
network is fitted to all that was gathered so far.
"""

from __future__ import annotations

import time

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from sada_gym.agents.training import batches
from sada_gym.envs.uav.agent.network import WaypointNetwork, light, new_network
from sada_gym.envs.uav.agent.pilot import WaypointPilot, in_drone, motion
from sada_gym.envs.uav.agent.privileged import Reference
from sada_gym.envs.uav.agent.recipe import Imitation
from sada_gym.envs.uav.camera.pinhole import camera
from sada_gym.envs.uav.races import Ending, Races

_PUSHES, _PUSH, _FADE = 0.06, 0.35, 0.85
"""How often a drone is pushed off its way, how hard (1: all it can), what is left a step later."""
_ASTRAY_M, _BEHIND_M = 15.0, 1.0
"""Farther from the next gate, or past it by more, a drone sets off anew."""
_NEAR_M = 2.0
"""Errors of a waypoint weigh as if it were farther by that."""
_DIRECTION_WEIGHT = 0.3


class Gathered:
    """What drones saw and felt, and where the next gate was: arrays filled from the front."""

    def __init__(self, size: int) -> None:
        self._count = 0
        self._pictures = np.empty((size, camera().rows, camera().columns, 3), np.uint8)
        self._felt = np.empty((size, 9), np.float32)
        self._answers = np.empty((size, 6), np.float32)

    def __len__(self) -> int:
        """Number of rows."""
        return self._count

    def add(
        self,
        pictures: npt.NDArray[np.uint8],
        felt: npt.NDArray[np.float32],
        answers: npt.NDArray[np.float32],
    ) -> None:
        """Add n rows; those beyond the size are dropped."""
        rows = slice(self._count, self._count + len(answers))
        room = len(self._answers[rows])
        self._pictures[rows], self._felt[rows] = pictures[:room], felt[:room]
        self._answers[rows] = answers[:room]
        self._count += room

    def batch(self, rows: npt.NDArray[np.intp]) -> tuple[Tensor, Tensor, Tensor]:
        """Pictures as light, what was felt, and the truth, of some rows."""
        return (
            light(torch.from_numpy(self._pictures[rows])),
            torch.from_numpy(self._felt[rows]),
            torch.from_numpy(self._answers[rows]),
        )


def imitate(settings: Imitation, *, seed: int) -> WaypointNetwork:
    """Train a network from nothing."""
    rng = np.random.default_rng(seed)
    network = new_network(seed)
    gathered = Gathered(settings.rounds * settings.steps)
    started = time.process_time()
    for number in range(settings.rounds):
        reference_share = 1.0 if number == 0 else 0.5**number
        astray = gather(network, settings, gathered, reference_share, rng)
        last = number == settings.rounds - 1
        loss = fit(
            network, gathered, settings, settings.last_epochs if last else settings.epochs, rng
        )
        print(
            f"round {number}: {len(gathered):,} pictures, {astray} drones went astray, "
            f"loss {loss:.4f}, {time.process_time() - started:.0f} s",
            flush=True,
        )
    return network.eval()


def gather(
    network: WaypointNetwork,
    settings: Imitation,
    gathered: Gathered,
    reference_share: float,
    rng: np.random.Generator,
) -> int:
    """Fly for a round, told the truth in a share of the races; gives how many went astray."""
    pilot, reference, drones = WaypointPilot(network), Reference(), settings.drones
    races = Races([settings.course.draw(rng) for _ in range(drones)])
    everyone = np.arange(drones)
    told = rng.random(drones) < reference_share
    push = np.zeros((drones, 4))
    astray = 0
    for _ in range(settings.steps // drones):
        looks = [start.seed for start in races.starts]
        gathered.add(
            camera().draw(races.gates, races.states, looks),
            motion(races.states),
            in_drone(races.states, races.waypoints(everyone)),
        )
        actions = reference.act(races, everyone)
        if not told.all():
            seeing = np.flatnonzero(~told)
            actions[seeing] = pilot.act(races, seeing)
        pushed = rng.random((drones, 1)) < _PUSHES
        fresh = rng.normal(0, _PUSH, (drones, 4)) * [1.0, 1.0, 0.4, 1.0]
        push = np.where(pushed, fresh, _FADE * push)
        races.step(everyone, actions + push)
        lost = strayed(races)
        over = races.next_gate == races.gates.shape[1]
        astray += int(lost.sum())
        for i in np.flatnonzero(lost | over).tolist():
            races.begin(i, settings.course.draw(rng))
            told[i] = rng.random() < reference_share
            push[i] = 0.0
    races.close()
    return astray


def strayed(races: Races) -> npt.NDArray[np.bool_]:
    """Which drones missed their gate: nothing ahead of them shows where it is."""
    gates = races.gates.shape[1]
    flying = np.flatnonzero(races.next_gate < gates)
    found: npt.NDArray[np.bool_] = np.any(races.endings > Ending.PASSED, axis=1)
    x, y, _, turn = races.waypoints(flying).T
    ahead = x * np.cos(turn) + y * np.sin(turn)
    found[flying] |= (ahead < -_BEHIND_M) | (np.hypot(x, y) > _ASTRAY_M)
    return found


def fit(
    network: WaypointNetwork,
    gathered: Gathered,
    settings: Imitation,
    epochs: int,
    rng: np.random.Generator,
) -> float:
    """Fit the network to all that was gathered; gives the last epoch's mean loss."""
    network.train()
    optimiser = torch.optim.Adam(network.parameters(), lr=settings.rate)
    steps = epochs * -(-len(gathered) // settings.batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.rate, total_steps=steps)
    mean = 0.0
    for _ in range(epochs):
        losses = []
        for rows in batches(len(gathered), settings.batch, rng):
            pictures, felt, truth = gathered.batch(rows)
            answer = network(_relit(pictures, settings.light_jitter, rng), felt)
            value = loss(answer, truth)
            optimiser.zero_grad()
            value.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            schedule.step()
            losses.append(float(value.detach()))
        mean = float(np.mean(losses))
    network.eval()
    return mean


def loss(answer: Tensor, truth: Tensor) -> Tensor:
    """The mean error of answers (n, 6): of a place relative to its distance, and of a direction."""
    error = (answer - truth).abs()
    far = truth[:, :3].norm(dim=1, keepdim=True) + _NEAR_M / 10
    mean: Tensor = (error[:, :3] / far).mean() + _DIRECTION_WEIGHT * error[:, 3:].mean()
    return mean


def _relit(pictures: Tensor, jitter: float, rng: np.random.Generator) -> Tensor:
    """Each picture (n, 3, rows, columns) in another light."""

    def draw(width: float, channels: int) -> Tensor:
        values = rng.uniform(-width, width, (len(pictures), channels, 1, 1))
        return torch.from_numpy(values.astype(np.float32))

    gain = 1 + draw(jitter, 1) + draw(jitter / 3, 3)
    return (pictures * gain + draw(jitter / 3, 1)).clamp_(0, 1)
