from dataclasses import FrozenInstanceError, dataclass

import numpy as np
import pytest

from sada_gym.adversaries.options import Options, choose_options, option
from sada_gym.errors import UserError


@dataclass(frozen=True)
class Some(Options):
    width: float = option(0.5, 0, 1, inside=True)
    count: int = option(3, 1, 1_000)
    pool: int | None = option(None, 1, 10, kind=int)
    sizes: tuple[int, ...] = option((1, 2), 1, 9, max_items=3)
    kind: str = option("fast", choices=("fast", "slow"))
    plain: float = 2.0
    flag: bool = True


def test_values_take_the_declared_types():
    some = Some(count=np.int64(5), sizes=[3, 4], plain=1, pool=7)
    assert some == Some(count=5, sizes=(3, 4), plain=1.0, pool=7)
    assert [type(value) for value in some.as_dict().values()] == [
        *(float, int, int, tuple, str, float, bool),
    ]
    with pytest.raises(FrozenInstanceError):
        some.count = 4


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"width": 1}, "width to be a float between 0 and 1, both excluded, such as 0.5; got 1"),
        ({"width": float("nan")}, "Expected width to be a float"),
        ({"count": 1_001}, "Expected count to be an int from 1 to 1,000, such as 3; got 1001"),
        ({"count": 2.0}, "Expected count to be an int"),
        ({"count": True}, "Expected count to be an int"),
        ({"count": None}, "Expected count to be an int"),
        ({"pool": 0}, "Expected pool to be an int from 1 to 10, or None; got 0"),
        ({"sizes": 1}, "Expected sizes to be a list of 1 to 3 items, each an int from 1 to 9"),
        ({"sizes": []}, "Expected sizes to be a list"),
        ({"sizes": [1] * 4}, "Expected sizes to be a list"),
        ({"kind": "slower"}, "Expected kind to be one of fast, slow, such as fast; got 'slower'"),
        ({"plain": "x"}, "Expected plain to be a float, such as 2.0; got 'x'"),
        ({"plain": float("inf")}, "Expected plain to be a float"),
        ({"plain": 10**400}, "Expected plain to be a float"),
        ({"flag": 1}, "Expected flag to be true or false"),
    ],
)
def test_bad_values_are_refused(bad, message):
    with pytest.raises(UserError, match=message):
        Some(**bad)


def test_a_preset_is_where_single_options_start_from():
    presets = {"default": Some(), "wide": Some(width=0.9, count=4)}
    assert choose_options("x", Some(), presets, "wide", {"count": 5}) == Some(width=0.9, count=5)
    assert choose_options("x", Some(), {}, "default", {}) == Some()
    with pytest.raises(UserError, match="preset to be one of default, wide"):
        choose_options("x", Some(), presets, "wider", {})
    with pytest.raises(UserError, match="Expected no preset with x, which has none"):
        choose_options("x", Some(), {}, "wide", {})
    with pytest.raises(UserError, match=r"option of x to be one of .*Did you mean width"):
        choose_options("x", Some(), presets, "default", {"with": 1})
