import pytest
import torch

from deblur_avatar.imaging.overlap import soft_iou


def test_overlap_is_of_coverage():
    one, other = torch.tensor([[1.0, 1.0, 0.0, 0.2]]), torch.tensor([[1.0, 0.0, 0.0, 0.4]])
    assert soft_iou(one, other) == pytest.approx(1.2 / 2.4)
    assert soft_iou(one, one) == 1
    assert soft_iou(one, 0 * one) == 0


def test_where_nobody_is_nothing_is_told():
    assert soft_iou(torch.zeros(2, 3), torch.zeros(2, 3)) is None
