"""Does training on failures help against conditions of images? A classifier of digits tells.

    python -m studies.image_repair --out runs/image-repair

It does what is missing and prints the table. The shipped `cnn` trains on: half of its pictures
are untouched, the other half are changed by what an arm says. `uniform` draws any conditions,
`failures` those that a `level-set` draws that attacked `cnn` on the training images, and
`randaugment` takes Cubuk et al.'s augmentation (1909.13719) of two operations at magnitude 9 of
30. All arms see equally many pictures in the same order. They are judged by test images: as they
are, in the same uniform worlds for all, and by a new attack. OUT gets a file an arm and a seed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageEnhance, ImageOps
from torch import Tensor, nn
from torch.nn import functional

from sada_gym import ImageApplication, agents, attack
from sada_gym.analyses.training.sources import as_source
from sada_gym.analyses.training.worlds import WorldSpace
from sada_gym.envs.digits.images import LabelledImages, test_images
from sada_gym.envs.images.conditions import developed
from sada_gym.evaluations import fools
from sada_gym.foundations.determinism import generators_kept, one_thread
from sada_gym.foundations.files import write_file
from sada_gym.measures.rates import wilson_interval
from studies.means import mean_text
from studies.training.digits.data import training_images

ARMS = ("none", "untouched", "randaugment", "uniform", "failures")
SEEDS = (0, 1, 2)
CONDITIONS: Mapping[str, Any] = {
    "rotation": True,
    "zoom": (0.75, 1.25),
    "shadow": (0.0, 2.0),
    "fog": (100.0, 10_000.0),
    "exposure": (-2.0, 2.0),
    "noise": True,
    "contrast": True,
    "jpeg": True,
}
"""Those that change 32 px, in ranges in which a person can still read most digits."""
ENLARGED = 4
EPOCHS, PICTURES, RATE = 20, 64, 1e-3
WORLDS, BUDGET, SAMPLES = 500, 400, 100
WORST = 0.1
_JUDGED, _ATTACKED = 10_000, 100
"""The seeds of judging worlds, and what new attacks add to theirs."""


class Enlarged(nn.Module):
    """Shows a classifier of 8 x 8 px the means of larger images, (B, 3, 32, 32) in [0, 1]."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        small = functional.avg_pool2d(images.mean(dim=1, keepdim=True), ENLARGED)
        logits: Tensor = self.network(small)
        return logits


def pictures(data: LabelledImages) -> np.ndarray:
    """Return digits as photographs are, (n, 32, 32, 3) uint8."""
    grey = np.rint(255.0 * data.images).astype(np.uint8)
    return np.repeat(grey.repeat(ENLARGED, axis=1).repeat(ENLARGED, axis=2)[..., None], 3, axis=3)


def application(network: nn.Module, data: LabelledImages) -> ImageApplication:
    """Return the application that attacks a classifier on these digits."""
    return ImageApplication(
        pictures(data),
        agent=Enlarged(network).eval(),
        labels=data.labels,
        conditions=CONDITIONS,
        fooling_threshold=0.5,
        name="Digits under conditions",
    )


def _sheared(image: Image.Image, matrix: tuple[float, ...]) -> Image.Image:
    return image.transform(image.size, Image.Transform.AFFINE, matrix, Image.Resampling.BILINEAR)


OPERATIONS: tuple[Callable[[Image.Image, float], Image.Image], ...] = (
    lambda i, _: i,
    lambda i, _: ImageOps.autocontrast(i),
    lambda i, _: ImageOps.equalize(i),
    lambda i, m: i.rotate(30.0 * m, Image.Resampling.BILINEAR),
    lambda i, m: ImageOps.posterize(i, 8 - round(4.0 * abs(m))),
    lambda i, m: ImageOps.solarize(i, round(255.0 * (1.0 - abs(m)))),
    lambda i, m: ImageEnhance.Contrast(i).enhance(1.0 + 0.9 * m),
    lambda i, m: ImageEnhance.Brightness(i).enhance(1.0 + 0.9 * m),
    lambda i, m: ImageEnhance.Sharpness(i).enhance(1.0 + 0.9 * m),
    lambda i, m: _sheared(i, (1.0, 0.3 * m, 0.0, 0.0, 1.0, 0.0)),
    lambda i, m: _sheared(i, (1.0, 0.0, 0.0, 0.3 * m, 1.0, 0.0)),
    lambda i, m: _sheared(i, (1.0, 0.0, 0.45 * m * i.width, 0.0, 1.0, 0.0)),
    lambda i, m: _sheared(i, (1.0, 0.0, 0.0, 0.0, 1.0, 0.45 * m * i.height)),
)
"""RandAugment's; `color` does nothing to grey."""


def augmented(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Change an image by RandAugment: two operations, magnitude 9 of 30, of either sign."""
    picture = Image.fromarray(image)
    for operation in rng.choice(len(OPERATIONS), 2):
        picture = OPERATIONS[operation](picture, float(rng.choice([-0.3, 0.3])))
    return np.asarray(picture)


def trained(arm: str, seed: int, source: Path) -> nn.Module:
    """Train `cnn` on by an arm."""
    data, _ = training_images()
    images, rng = pictures(data), np.random.default_rng(seed)
    network: nn.Module = deepcopy(agents.load("cnn", "SADA-Digits"))
    worlds = application(network, data)
    network = network.train().requires_grad_(True)
    pool = None
    if arm == "failures":
        pool = as_source(source).pool(WorldSpace(worlds.name, worlds.parameters))

    def changed(image: np.ndarray) -> np.ndarray:
        if arm in ("none", "untouched"):
            return image
        if arm == "randaugment":
            return augmented(image, rng)
        mu = rng.uniform(-1.0, 1.0, (1, len(worlds.parameters))).astype(np.float32)
        if pool is not None:
            mu = pool[[rng.integers(len(pool))]]
        values = iter(worlds.parameters.physical(mu)[0].tolist())
        own = [tuple(next(values) for _ in each.parameters) for each in worlds.conditions]
        return developed(image, worlds.conditions, own, rng.integers(2**31, size=2).tolist()).image

    optimiser = torch.optim.AdamW(network.parameters(), RATE)
    order = np.random.default_rng([seed, 1])  # the same for all arms
    with one_thread(), generators_kept():
        for _ in range(EPOCHS):
            for rows in np.array_split(order.permutation(len(data)), len(data) // PICTURES):
                batch = images[rows].copy()
                for i in range(len(rows) // 2):
                    batch[i] = changed(batch[i])
                given = torch.from_numpy(batch.transpose(0, 3, 1, 2).astype(np.float32) / 255.0)
                loss = functional.cross_entropy(
                    Enlarged(network)(given), torch.from_numpy(data.labels[rows])
                )
                optimiser.zero_grad(set_to_none=True)
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
    return network.eval().requires_grad_(False)


def attacked(network: nn.Module, data: LabelledImages, seed: int, out: Path) -> float:
    """Attack a classifier, and return the attack fooling rate."""
    run = attack(
        application(network, data),
        budget=BUDGET,
        samples=SAMPLES,
        seed=seed,
        out=out,
        resume=True,
        diagnose=False,
        pictures=False,
        progress=False,
    )
    return float(run.samples.fooled(0.5).mean())


def run(arm: str, seed: int, out: Path) -> dict[str, Any]:
    """Train by one arm and judge it, or read what was found before."""
    file = out / f"{arm}-{seed}.json"
    with suppress(FileNotFoundError):
        known: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        return known
    base, test = agents.load("cnn", "SADA-Digits"), test_images()
    source = out / f"source-{seed}"
    attacked(base, training_images()[0], seed, source)
    network = base if arm == "none" else trained(arm, seed, source)
    logits = Enlarged(network)(torch.from_numpy(pictures(test).transpose(0, 3, 1, 2)) / 255.0)
    judge, rng = application(network, test), np.random.default_rng(_JUDGED)
    mu = rng.uniform(-1.0, 1.0, (WORLDS, len(judge.parameters))).astype(np.float32)
    uniform = judge.evaluate(mu, rng.integers(2**31, size=WORLDS).tolist()).score
    found = {
        "untouched": float((logits.argmax(1).numpy() == test.labels).mean()),
        "uniform": float(uniform.mean()),
        "fooled": int(fools(uniform, 0.5).sum()),
        "cvar": float(np.sort(uniform)[: round(WORST * WORLDS)].mean()),
        "attack": attacked(network, test, _ATTACKED + seed, out / f"{arm}-{seed}"),
    }
    write_file(file, json.dumps(found, indent=1).encode())
    print(arm, seed, found, flush=True)
    return found


def table(found: Mapping[str, list[dict[str, Any]]]) -> Iterator[str]:
    """Yield the table: means over the seeds and pooled rates, with 95 % intervals."""
    yield (
        "| extra training | untouched, % right | uniform worlds, % right | worst 10 %, % right | "
        "uniform worlds that fool, % | a new `level-set` fools, % |"
    )
    yield "| --- " * 6 + "|"
    for arm, rows in found.items():
        means = [
            mean_text([100.0 * row[key] for row in rows], 1)
            for key in ("untouched", "uniform", "cvar")
        ]
        rates = []
        for key, trials in (("fooled", WORLDS), ("attack", SAMPLES)):
            counts = [round(row[key] if key == "fooled" else trials * row[key]) for row in rows]
            low, high = wilson_interval(sum(counts), trials * len(rows))
            share = 100.0 * sum(counts) / (trials * len(rows))
            each = ", ".join(f"{100.0 * count / trials:.0f}" for count in counts)
            rates.append(f"{share:.1f} ({100 * low:.1f} to {100 * high:.1f}); {each}")
        yield f"| {arm} | {' | '.join(means + rates)} |"


def main() -> None:
    """Do what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/image-repair"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    found = {arm: [run(arm, seed, out) for seed in SEEDS] for arm in ARMS}
    print("\n".join(table(found)))


if __name__ == "__main__":
    main()
