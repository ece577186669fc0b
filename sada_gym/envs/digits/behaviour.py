"""What a classifier did: which class it took the image for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sada_gym.foundations.behaviour import Behaviour


def behaviour(info: Mapping[str, Any]) -> Behaviour:
    """Say what a classifier took an image for, by the info of an evaluation."""
    label, predicted = info["label"], info["predicted"]
    data = {"label": label, "predicted": predicted}
    if label != predicted:
        event = f"taken for {with_article(predicted)}"
        return Behaviour(f"{with_article(label)}, {event}", (event,), data=data)
    if info["fooled"]:
        return Behaviour(f"{with_article(label)}, with little confidence", ("unsure",), data=data)
    return Behaviour(f"seen to be {with_article(label)}", data=data)


def with_article(number: int) -> str:
    """Name a class with its article: `an 8`."""
    return f"an {number}" if str(number).startswith("8") or number in (11, 18) else f"a {number}"
