"""Nearest neighbours: against all pairs, and what Ctrl-C may not free."""

import os
import signal

import pytest
import torch

from deblur_avatar.geometry import nearest as searching
from deblur_avatar.geometry.nearest import nearest


def points(count: int, dimensions: int = 3, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(count, dimensions, generator=generator)


@pytest.mark.parametrize(("dimensions", "count"), [(3, 1), (3, 4), (2, 2)])
def test_neighbours_are_those_of_all_pairs(dimensions, count):
    asked, among = points(30, dimensions), points(50, dimensions, seed=1)
    distances, indices = nearest(asked, among, count)
    pairs = torch.cdist(asked.double(), among.double())
    wanted = pairs.topk(count, largest=False)
    assert indices.equal(wanted.indices)
    assert torch.allclose(distances, wanted.values, atol=1e-12)


def test_fewer_than_asked_for_are_all_there_are():
    found = nearest(points(5), points(2, seed=1), 4)
    assert found.indices.shape == found.distances.shape == (5, 2)
    assert found.indices.sort().values.equal(torch.tensor([[0, 1]]).expand(5, 2))


def test_what_is_fitted_may_be_asked():
    asked = points(5).requires_grad_()
    assert not nearest(asked, asked).distances.requires_grad


def test_the_search_is_over_before_ctrl_c_frees_what_it_reads(monkeypatch):
    over = []

    class Interrupted(searching.cKDTree):
        def query(self, *arguments, **options):
            os.kill(os.getpid(), signal.SIGINT)
            found = super().query(*arguments, **options)
            over.append(True)
            return found

    monkeypatch.setattr(searching, "cKDTree", Interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            nearest(points(5), points(5))
    finally:
        signal.signal(signal.SIGINT, before)
    assert over
