"""What the training scripts of drivers and pilots take from the command line."""

from __future__ import annotations

import argparse


def check_options(
    parser: argparse.ArgumentParser, seed: int, steps: int | None, *, least: int, crowd: str
) -> None:
    """End the script with a sentence where it cannot train with what was asked for.

    Args:
        parser: Says it.
        seed: Fixes the training.
        steps: How many, None for the recipe's.
        least: The recipe's agents, each of which takes a step at a time.
        crowd: What these are called.
    """
    if not 0 <= seed < 2**31:
        parser.error(f"Expected --seed from 0 to {2**31 - 1}, got {seed}.")
    if steps is not None and steps < least:
        parser.error(
            f"Expected --steps of at least {least}, one for each of the recipe's {crowd}, "
            f"got {steps}."
        )
