import random
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest
import torch
from threadpoolctl import threadpool_info, threadpool_limits

from sada_gym.foundations.determinism import generators_kept, single_threaded
from sada_gym.oracle import Oracle


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


def threads():
    """Return the threads of torch, BLAS and OpenMP."""
    return [torch.get_num_threads(), *(pool["num_threads"] for pool in threadpool_info())]


@pytest.fixture
def three_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    with threadpool_limits(3):
        yield threads()
    torch.set_num_threads(before)


def test_evaluations_have_one_thread_and_their_caller_keeps_its_own(three_threads):
    assert set(three_threads) == {3}
    with single_threaded():
        with single_threaded():
            assert set(threads()) == {1}
        assert set(threads()) == {1}
    assert threads() == three_threads


def test_an_error_inside_restores_the_threads(three_threads):
    with pytest.raises(KeyError), single_threaded():
        raise KeyError
    assert threads() == three_threads


def test_who_leaves_last_restores_nothing_of_another(three_threads):
    both, first = Barrier(2, timeout=30), Barrier(2, timeout=30)

    def leave_first():
        with single_threaded():
            both.wait()
        first.wait()

    with ThreadPoolExecutor(1) as executor:
        left = executor.submit(leave_first)
        with single_threaded():
            both.wait()
            first.wait()
        left.result()
    assert threads() == three_threads


def test_a_function_is_scored_in_one_thread(three_threads):
    asked = []

    def black_box(mu):
        asked.extend(threads())
        return np.zeros(len(mu))

    with Oracle(black_box, budget=2, dimension=2, threshold=0.3) as oracle:
        oracle(np.zeros((2, 2)))
    assert set(asked) == {1}
    assert threads() == three_threads
