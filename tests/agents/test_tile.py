"""Batches of any size are shown to networks in tiles of one size."""

import numpy as np
import pytest
import torch

from sada_gym.agents.tile import tiled


class Recorder:
    """A network that doubles numbers and keeps what it was shown."""

    def __init__(self):
        self.shown = []

    def __call__(self, batch):
        self.shown.append(batch["x"])
        return 2 * batch["x"]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 9])
def test_a_network_sees_full_tiles_only_and_every_row_gets_its_answer(count):
    network, x = Recorder(), np.arange(1.0, count + 1)[:, None]
    np.testing.assert_array_equal(np.concatenate(tiled(network, {"x": x}, 3)), 2 * x)
    assert {len(tile) for tile in network.shown} == {3}
    assert len(network.shown) == -(-count // 3)


@pytest.mark.parametrize(("blank", "filling"), [(True, 0.0), (False, 4.0)])
def test_the_last_tile_is_filled_with_zeros_or_its_first_row(blank, filling):
    network, x = Recorder(), np.arange(1.0, 6.0)[:, None]
    tiled(network, {"x": x}, 3, blank=blank)
    assert network.shown[-1].ravel().tolist() == [4.0, 5.0, filling]


def test_no_rows_are_no_answers():
    assert tiled(Recorder(), {"x": np.empty((0, 2))}, 3) == []


def test_a_transposed_picture_lies_in_memory_in_one_order_in_every_tile():
    network = Recorder()
    pictures = np.zeros((5, 4, 6, 3), np.float32).transpose(0, 3, 1, 2)
    tiled(network, {"x": pictures}, 3)
    assert {tile.strides for tile in network.shown} == {network.shown[0].strides}


def test_torch_computes_in_one_thread_and_has_as_many_as_before_afterwards():
    before, within = torch.get_num_threads(), []
    tiled(lambda batch: within.append(torch.get_num_threads()) or batch["x"], {"x": np.ones(1)}, 1)
    assert within == [1]
    assert torch.get_num_threads() == before
