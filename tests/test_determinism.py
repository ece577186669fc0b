import random

import numpy as np
import pytest
import torch

from sada_gym.determinism import generators_kept


def draw():
    return random.random(), np.random.random(), torch.rand(1).item()  # noqa: NPY002


def seed():
    random.seed(3)
    np.random.seed(3)  # noqa: NPY002
    torch.manual_seed(3)


def test_generators_go_on_where_they_were():
    seed()
    expected = draw()
    seed()
    with generators_kept():
        random.seed(8)
        np.random.seed(8)  # noqa: NPY002
        torch.manual_seed(8)
        assert draw() != expected
    assert draw() == expected


def test_an_error_inside_leaves_them_as_they_were():
    def fail():
        with generators_kept():
            torch.manual_seed(8)
            random.seed(8)
            raise KeyError

    seed()
    expected = draw()
    seed()
    with pytest.raises(KeyError):
        fail()
    assert draw() == expected
