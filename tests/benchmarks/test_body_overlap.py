"""The benchmark of how far a body can cover its mattes."""

import dataclasses

import pytest
import torch

from benchmarks.body_overlap import a_pixel_apart, row


def test_mattes_a_pixel_apart_share_all_but_their_edges(observations):
    mattes = torch.zeros_like(observations.mattes)
    mattes[:, 4:12, 3:13] = 255  # ten columns, of which nine stay
    cut = dataclasses.replace(observations, mattes=mattes)
    assert a_pixel_apart(cut) == pytest.approx(9 / 11)
    found = row(cut)
    assert found["a_pixel_apart"] == pytest.approx(9 / 11, abs=1e-3)
    assert 0 <= found["mask_body_iou"] <= 1
    assert found["pixels"] == list(mattes.shape[1:])
