"""The training of BBGAN: a generator and a discriminator on the induced set."""

from __future__ import annotations

import copy
from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from sada_gym.adversaries.bbgan_networks import Discriminator, Generator
from sada_gym.adversaries.bbgan_options import BBGANOptions
from sada_gym.adversaries.query_pool import InducedSet
from sada_gym.adversaries.training_log import TrainingLog
from sada_gym.errors import TrainingDiverged

_LOG_EVERY = 25


def train_gan(
    induced: InducedSet,
    o: BBGANOptions,
    generator: torch.Generator,
    log: TrainingLog | None,
    on_step: Callable[[int, int], None] | None = None,
) -> tuple[Generator, Discriminator]:
    """Train and return G and D by the paper's BBGAN objective: S is real, G's samples are fake.

    With `o.rest` the points of Omega that do not fool are fake as well, so that D learns from all
    of Omega (compare Asokan & Seelamantula 2020, "Teaching a GAN what not to learn"). Where the
    fooling rate p(mu) is noisy, G is then drawn to where p is high; without noise its optimum is
    unchanged. Weights are averaged over the steps where `o.average` says so.

    Raises:
        TrainingDiverged: If a loss or a weight is not finite any more.
    """
    real, rest = torch.from_numpy(induced.chosen), torch.from_numpy(induced.rest)
    g = Generator(real.shape[1], o, generator)
    d = Discriminator(real.shape[1], o, generator)
    average_g, average_d = copy.deepcopy(g), copy.deepcopy(d)
    betas = (o.beta1, o.beta2)
    optimiser_g = torch.optim.Adam(g.parameters(), o.learning_rate, betas)
    optimiser_d = torch.optim.Adam(d.parameters(), o.learning_rate, betas)
    weight = min(o.rest, len(rest) / len(real))

    for step in range(o.steps):
        if o.decay:
            rate = o.learning_rate * min(1.0, 2.0 * (1.0 - step / o.steps))
            for group in (*optimiser_g.param_groups, *optimiser_d.param_groups):
                group["lr"] = rate

        for _ in range(o.discriminator_updates):
            with torch.no_grad():
                fake, _ = g(o.batch, generator)
            batches = [_draw(real, o.batch, generator), fake]
            if weight:
                batches.append(_draw(rest, o.batch, generator))
            logits = d(torch.cat(batches), generator).split(o.batch)
            loss_d = softplus(-logits[0]).mean() + softplus(logits[1]).mean()
            if weight:
                loss_d = loss_d + weight * softplus(logits[2]).mean()
            optimiser_d.zero_grad()
            torch.autograd.backward(loss_d)
            optimiser_d.step()

        for _ in range(o.generator_updates):
            fake, shift = g(o.batch, generator)
            loss_g = softplus(-d(fake, generator)).mean()  # non-saturating
            if o.tether:
                loss_g = loss_g + o.tether * shift.square().sum(dim=1).mean()
            optimiser_g.zero_grad()
            torch.autograd.backward(loss_g)
            optimiser_g.step()

        keep = min(o.average, (step + 1) / (step + 10)) if o.average else 0.0
        _average(average_g, g, keep)
        _average(average_d, d, keep)

        if not bool((loss_d.detach() + loss_g.detach()).isfinite()):
            raise _diverged(step, o)
        if log and (step % _LOG_EVERY == 0 or step == o.steps - 1):
            losses = {"loss/discriminator": loss_d, "loss/generator": loss_g}
            log.scalars(step, {name: float(loss.detach()) for name, loss in losses.items()})
            # a generator of their own: a log must not change the result
            shown = torch.Generator().manual_seed(step)
            with torch.no_grad():
                log.samples(step, average_g(500, shown)[0].numpy())
        if on_step is not None:
            on_step(step + 1, o.steps)
    # a last step may have ruined weights that still gave a finite loss
    for network in (average_g, average_d):
        if not all(bool(weights.isfinite().all()) for weights in network.parameters()):
            raise _diverged(o.steps, o)
    return average_g, average_d


def _diverged(step: int, o: BBGANOptions) -> TrainingDiverged:
    return TrainingDiverged(
        f"Expected the GAN's training to stay finite, but its loss or weights became infinite or "
        f"NaN after {step} of {o.steps} steps. Lower learning_rate (it is {o.learning_rate:g}) or "
        f"initial_sd (it is {o.initial_sd:g}; 0 takes PyTorch's own scale), or take fewer layers."
    )


def _draw(points: Tensor, n: int, generator: torch.Generator) -> Tensor:
    return points[torch.randint(len(points), (n,), generator=generator)]


def _average(running: nn.Module, latest: nn.Module, keep: float) -> None:
    with torch.no_grad():
        for old, new in zip(running.parameters(), latest.parameters(), strict=True):
            old.lerp_(new, 1.0 - keep)
