"""The benchmark of a step on a GPU: what it compares, and that it says where there is no GPU."""

import pytest
import torch

from benchmarks.gpu_step import in_plain_torch, main
from deblur_avatar.avatars import knn_smoothness
from deblur_avatar.rendering import covariance_factors, posing
from deblur_avatar.training import picture_losses


def test_twins_compute_while_kernels_are_put_away(monkeypatch):
    modules = (posing, covariance_factors, knn_smoothness, picture_losses)
    for module in modules:
        monkeypatch.setattr(module, "_cuda_library", lambda: "kernels")
    with in_plain_torch():
        assert [module._cuda_library() for module in modules] == [None] * 4
    assert [module._cuda_library() for module in modules] == ["kernels"] * 4


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU here")
def test_without_a_gpu_it_says_so():
    with pytest.raises(SystemExit, match="torch sees none here"):
        main(None)
