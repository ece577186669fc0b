"""Train a detector: `python -m studies.training.detection.train photographer --out DIR`.

The script renders the training set, trains for a fixed number of epochs and keeps the last weights:
nothing is chosen by a score. It measures them, and writes weights and model card to --out.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from sada_gym.agents.weights import save_weights
from sada_gym.envs.detection.agent.network import STRIDE, Detector, boxes_at
from sada_gym.envs.detection.shapes.catalogue import CLASSES
from studies.training.detection.card import write_card
from studies.training.detection.data import LabelledFrames, batches, training_frames
from studies.training.detection.evaluate import measure
from studies.training.detection.recipe import RECIPES, DetectorRecipe


def train(recipe: DetectorRecipe, seed: int, *, checkpoint: Path | None = None) -> Detector:
    """Train a detector from scratch.

    Args:
        recipe: How.
        seed: Fixes data, initial weights and order.
        checkpoint: Where to keep the weights after every epoch.
    """
    frames = training_frames(
        recipe.per_class,
        survey_share=recipe.survey_share,
        empty_share=recipe.empty_share,
        image_size=recipe.image_size,
        seed=seed,
    )
    print(f"rendered {len(frames.images)} frames", flush=True)
    rng = np.random.default_rng([seed, 1])
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        model = Detector(CLASSES)
    model.train().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimiser = torch.optim.AdamW(model.parameters(), lr=recipe.rate, weight_decay=1e-3)
    steps = recipe.epochs * (len(frames.images) // recipe.batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, recipe.rate, total_steps=steps)
    for epoch in range(recipe.epochs):
        started, total, count = time.perf_counter(), 0.0, 0
        for batch in batches(frames, recipe.batch, rng):
            loss = detection_loss(model, batch)
            optimiser.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(model.parameters(), 10.0)
            optimiser.step()
            schedule.step()
            total, count = total + loss.item(), count + 1
        took = time.perf_counter() - started
        print(f"epoch {epoch + 1}: loss {total / count:.4f}, {took:.0f} s", flush=True)
        if checkpoint is not None:
            save_weights(model, checkpoint)
    return model.eval().requires_grad_(False)


def detection_loss(model: Detector, batch: LabelledFrames) -> Tensor:
    """Return the heat map's focal loss (Law & Deng 2018, eq. 1) plus the boxes' GIoU loss."""
    images = torch.from_numpy(batch.images).permute(0, 3, 1, 2).float() / 255
    logits, reach = model.maps(images)
    heat, centre = targets(batch, tuple(logits.shape[1:]))
    hard = heat >= 1
    score = logits.sigmoid()
    hits = functional.logsigmoid(logits) * (1 - score) ** 2 * hard
    spurious = functional.logsigmoid(-logits) * score**2 * (1 - heat) ** 4 * ~hard
    count = max(1, int((batch.labels > 0).sum()))
    frame, cell = (centre > 0.4).flatten(1).nonzero(as_tuple=True)
    if not len(frame):
        return -spurious.sum() / count
    cells = cell.new_full((len(images), int(torch.bincount(frame).max())), -1)
    slot = torch.arange(len(frame)) - (frame[:, None] > frame[None]).sum(1)
    cells[frame, slot] = cell
    boxes = boxes_at(reach, cells.clamp(min=0))[frame, slot]
    weight = centre.flatten(1)[frame, cell]
    loss = 1 - giou(boxes, torch.from_numpy(batch.boxes)[frame])
    return -(hits + spurious).sum() / count + 2 * (loss * weight).sum() / weight.sum()


def targets(batch: LabelledFrames, shape: tuple[int, ...]) -> tuple[Tensor, Tensor]:
    """Draw heat maps (b, classes, h, w), a Gaussian at each centre, and their maximum (b, h, w)."""
    classes, height, width = shape
    heat = torch.zeros(len(batch.labels), classes, height, width)
    x, y = torch.arange(width) + 0.5, torch.arange(height) + 0.5
    for i, label in enumerate(batch.labels.tolist()):
        if label:
            x0, y0, x1, y1 = (batch.boxes[i] / STRIDE).tolist()
            cx, cy = min((x0 + x1) / 2, width - 0.01), min((y0 + y1) / 2, height - 0.01)
            cx, cy = math.floor(max(cx, 0)) + 0.5, math.floor(max(cy, 0)) + 0.5
            sx, sy = max(0.6, (x1 - x0) / 8), max(0.6, (y1 - y0) / 8)
            across = torch.exp(-0.5 * ((x - cx) / sx) ** 2)
            heat[i, label - 1] = torch.exp(-0.5 * ((y - cy) / sy) ** 2)[:, None] * across
    return heat, heat.amax(1)


def giou(a: Tensor, b: Tensor) -> Tensor:
    """Return generalised intersection over union of boxes (..., 4) (Rezatofighi et al. 2019)."""
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    shared = (high - low).clamp(min=0).prod(-1)
    union = (a[..., 2:] - a[..., :2]).prod(-1) + (b[..., 2:] - b[..., :2]).prod(-1) - shared
    hull = torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])
    area = hull.prod(-1)
    return shared / union.clamp(min=1e-9) - (area - union) / area.clamp(min=1e-9)


def main() -> None:
    """Train, save, measure, write the card."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=sorted(RECIPES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True, help="folder for weights and card")
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    arguments.out.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    weights = arguments.out / f"{arguments.name}.safetensors"
    model = train(RECIPES[arguments.name], arguments.seed, checkpoint=weights)
    minutes = (time.perf_counter() - started) / 60
    save_weights(model, weights)
    print(f"trained in {minutes:.1f} minutes on {arguments.threads} thread(s)", flush=True)
    figures = measure(model, seed=arguments.seed + 1_000)
    write_card(
        arguments.out / f"{arguments.name}.md",
        name=arguments.name,
        recipe=RECIPES[arguments.name],
        seed=arguments.seed,
        minutes=minutes,
        weights=weights,
        figures=figures,
    )


if __name__ == "__main__":
    main()
