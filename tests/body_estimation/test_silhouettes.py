import cv2
import numpy as np
import pytest
import torch

from deblur_avatar.body_estimation.silhouettes import (
    OUTLINE_POINTS,
    SHRINK,
    distance_outside,
    nearest_points,
    silhouettes,
)

SIZE, CENTRE, RADIUS = 160, (80.0, 72.0), 32.0


def disc() -> torch.Tensor:
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    inside = np.hypot(columns - CENTRE[0], rows - CENTRE[1]) <= RADIUS
    return torch.from_numpy(inside.astype(np.uint8) * 255)


def test_points_inside_a_matte_are_at_no_distance_and_others_at_their_own():
    outside = silhouettes([disc()[None]]).outside[0]
    pixels = torch.tensor([[[80.0, 72.0], [100.0, 80.0], [80.0, 144.0], [20.0, 72.0]]])
    distances = distance_outside(outside, pixels)[0]
    assert distances[:2].tolist() == [0, 0]
    assert distances[2:].tolist() == pytest.approx([40, 28], abs=SHRINK / 2)


@pytest.mark.parametrize("threads", [1, 2])
def test_distances_are_exact_and_the_same_with_any_number_of_threads(threads: int):
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(threads)
        found = [silhouettes([disc()[None]]).outside[0, 0] for _ in range(3)]
    finally:
        cv2.setNumThreads(before)
    cells = disc().unflatten(0, (-1, SHRINK)).unflatten(2, (-1, SHRINK)).float().mean((1, 3))
    within, everywhere = (cells >= 128).nonzero(), torch.ones_like(cells).nonzero()
    squared = (everywhere[:, None] - within).square().sum(-1).amin(1)
    exact = SHRINK * squared.double().sqrt().float().reshape(cells.shape)
    assert all(torch.equal(outside, exact) for outside in found)


def test_distance_grows_away_from_the_matte():
    outside = silhouettes([disc()[None]]).outside[0]
    pixels = torch.tensor([[[80.0, 120.0]]], requires_grad=True)
    distance_outside(outside, pixels).sum().backward()
    assert pixels.grad is not None
    assert pixels.grad[0, 0].tolist() == pytest.approx([0, 1], abs=0.1)


def test_outline_points_lie_on_the_edge_and_look_outwards():
    found = silhouettes([disc()[None]])
    spokes = found.outline[0, 0] - torch.tensor(CENTRE)
    assert spokes.shape == (OUTLINE_POINTS, 2)
    assert (spokes.norm(dim=1) - RADIUS).abs().max() < 1.5
    cosine = (found.normals[0, 0] * spokes / spokes.norm(dim=1, keepdim=True)).sum(1)
    assert cosine.min() > 0.95


def test_specks_have_no_outline():
    matte = disc()
    matte[5:8, 5:8] = 255
    found = silhouettes([matte[None]])
    assert found.outline[0, 0].amin() > 20


def test_a_frame_without_a_person_is_not_shown():
    found = silhouettes([torch.stack([disc(), torch.zeros_like(disc())])])
    assert found.shown.tolist() == [[True, False]]
    assert found.outside[0, 1].max() == 0


def test_each_outline_point_has_the_nearest_projected_point_as_partner():
    outline = torch.tensor([[[0.0, 0.0], [10.0, 0.0]]])
    pixels = torch.tensor([[[9.0, 3.0], [1.0, 1.0], [-4.0, 0.0]]])
    assert nearest_points(outline, pixels).tolist() == [[1, 0]]
