"""Train a classifier: `python -m studies.training.digits.train cnn --seed 0 --out DIR`.

It learns from the training digits for a fixed number of epochs and keeps the last weights: nothing
is chosen by a score. Two more are trained with the next seeds, to show by how much they differ. The
first is written with a model card to --out; `sada_gym/envs/digits/card.py` has its SHA-256.

--validation trains without the validation images, measures on them, and writes nothing: by that
the hyper-parameters were chosen.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional

from sada_gym.agents.weights import save_weights
from sada_gym.envs.digits.agent.network import DigitNetwork, new_network
from sada_gym.envs.digits.images import LabelledImages
from sada_gym.foundations.determinism import one_thread
from studies.training.common import ModelCard
from studies.training.digits.data import batches, training_images
from studies.training.digits.evaluate import SAMPLES, accuracy, measure, table
from studies.training.digits.recipe import RECIPES, ClassifierRecipe

TRAININGS = 3


def train(recipe: ClassifierRecipe, data: LabelledImages, *, seed: int) -> DigitNetwork:
    """Train a classifier from scratch, in one thread: more would give other last bits.

    Args:
        recipe: How.
        data: The images to learn from.
        seed: Fixes initial weights, order and changes.
    """
    rng = np.random.default_rng(seed)
    network = new_network(seed).train()
    optimiser = torch.optim.AdamW(
        network.parameters(), lr=recipe.rate, weight_decay=recipe.weight_decay
    )
    steps = recipe.epochs * -(-len(data) // recipe.batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, recipe.rate, total_steps=steps)
    with one_thread():
        for _ in range(recipe.epochs):
            for images, labels in batches(data, recipe, rng):
                logits = network(torch.from_numpy(images)[:, None])
                loss = functional.cross_entropy(logits, torch.from_numpy(labels))
                optimiser.zero_grad(set_to_none=True)
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
                schedule.step()
    return network.eval().requires_grad_(False)


def validate(recipe: ClassifierRecipe, seeds: range) -> None:
    """Print the accuracy on the validation images of trainings without them."""
    train_part, validation_part = training_images(validation=True)
    for seed in seeds:
        network = train(recipe, train_part, seed=seed)
        right, count = accuracy(network, validation_part)
        print(f"seed {seed}: {right} of {count} validation images right", flush=True)


def write_card(
    weights: Path, recipe: ClassifierRecipe, seed: int, seconds: float, figures: str, images: int
) -> None:
    """Write a model card: how the classifier was trained, its file's SHA-256, what it scores."""
    name = weights.stem
    parameters = sum(v.numel() for v in DigitNetwork().parameters())
    ModelCard(
        name=name,
        description=f"""A classifier of ten digits ({parameters:,} parameters,
`sada_gym/envs/digits/agent/network.py`), trained on {images:,} of scikit-learn's 1,797 handwritten
digits, 8 x 8 pixels. The test images are the 4th, 8th, 12th ... of each digit in the data set's
order; no training has seen them. The hyper-parameters were chosen on the 3rd, 7th, 11th ... of
each digit, with trainings that had not seen these (`train --validation`); the shipped weights
learnt from them, too.""",
        command=f"python -m studies.training.digits.train {name} --seed {seed} --out DIR",
        training=f"{seconds:.0f} seconds of one core",
        recipe=recipe,
        measured=f"""Measured by
`python -m studies.training.digits.evaluate FILE --seed {seed + 1_000}`: the test images as they
are, and {SAMPLES:,} uniform mu of `SADA-Digits-v0`, fooled where Q <= 0.1; for the shipped
training, {SAMPLES:,} of each digit's id, too.""",
        figures=figures,
    ).write(weights.with_suffix(".md"), weights)


def main() -> None:
    """Train, measure, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=sorted(RECIPES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder for weights and card")
    parser.add_argument("--validation", action="store_true", help="measure on validation images")
    arguments = parser.parse_args()
    recipe, seeds = RECIPES[arguments.name], range(arguments.seed, arguments.seed + TRAININGS)
    if not 0 <= arguments.seed < 2**31:
        parser.error(f"Expected --seed from 0 to {2**31 - 1}, got {arguments.seed}.")
    if arguments.validation:
        validate(recipe, seeds)
        return
    if arguments.out is None:
        parser.error("Expected --out DIR, a folder for weights and card, got none.")
    data, _ = training_images()
    started = time.process_time()
    networks = {seed: train(recipe, data, seed=seed) for seed in seeds}
    seconds = (time.process_time() - started) / TRAININGS
    weights = arguments.out / f"{arguments.name}.safetensors"
    arguments.out.mkdir(parents=True, exist_ok=True)
    save_weights(networks[arguments.seed], weights)
    figures = {
        f"training seed {own}": measure(network, seed=arguments.seed + 1_000)
        for own, network in networks.items()
    }
    text = table(figures)
    print(text)
    write_card(weights, recipe, arguments.seed, seconds, text, len(data))


if __name__ == "__main__":
    main()
