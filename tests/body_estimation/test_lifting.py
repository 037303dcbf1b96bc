import pytest
import torch

from deblur_avatar.body_estimation import lifting
from deblur_avatar.body_estimation.first_guess import spline_basis
from deblur_avatar.body_estimation.lifting import lift
from deblur_avatar.body_estimation.pace import pace_of
from deblur_avatar.geometry.cameras import look_at, project

FRAMES, INTERVAL = 12, 1 / 24
K = torch.tensor([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]])
VIEWMAT = look_at(
    torch.tensor([1.0, 0.5, 5.0]), torch.tensor([0.0, 0.2, 0.0]), torch.tensor([0.0, 1.0, 0.0])
)
PACE = pace_of(torch.arange(FRAMES) * INTERVAL)
BASIS = spline_basis(PACE, 2 * INTERVAL)


def scene() -> tuple[torch.Tensor, torch.Tensor]:
    """A cloud of points as large as a person that walks away, and its shape in camera axes."""
    generator = torch.Generator().manual_seed(0)
    shape = torch.rand(20, 3, generator=generator) - 0.5
    shape = shape * torch.tensor([0.6, 1.7, 0.4])
    way = torch.stack([torch.linspace(0, 0.4, FRAMES), torch.zeros(FRAMES),
                       -torch.linspace(0, 0.5, FRAMES)], dim=-1)  # fmt: skip
    return shape + way[:, None], shape @ VIEWMAT[:3, :3].T


def lifted(
    pixels: torch.Tensor,
    confidences: torch.Tensor,
    shape: torch.Tensor,
    *,
    any_pose: bool = False,
) -> torch.Tensor:
    guess = shape.expand(FRAMES, -1, -1)
    return lift(
        pixels, confidences, guess, K, VIEWMAT, BASIS, 300.0, PACE, any_pose=any_pose
    ).points


def test_a_known_shape_is_put_where_it_is_seen():
    points, shape = scene()
    pixels, _ = project(points, K, VIEWMAT)
    found = lifted(pixels, torch.ones(FRAMES, 20), shape)
    assert (found - points).norm(dim=-1).max() < 0.02


def test_a_shape_twice_as_tall_is_twice_as_far():
    points, shape = scene()
    pixels, _ = project(points, K, VIEWMAT)
    centre = torch.linalg.inv(VIEWMAT)[:3, 3]
    found = lifted(pixels, torch.ones(FRAMES, 20), 2 * shape)
    assert (found - centre - 2 * (points - centre)).norm(dim=-1).max() < 0.05


def test_wrong_pixels_hardly_move_it():
    points, shape = scene()
    pixels, _ = project(points, K, VIEWMAT)
    pixels[4, :5] += 150
    found = lifted(pixels, torch.ones(FRAMES, 20), shape)
    assert (found - points).norm(dim=-1).max() < 0.08


def test_what_is_not_seen_is_not_found():
    points, shape = scene()
    pixels, _ = project(points, K, VIEWMAT)
    confidences = torch.ones(FRAMES, 20)
    confidences[3:5] = 0
    guess = shape.expand(FRAMES, -1, -1)
    found = lift(pixels, confidences, guess, K, VIEWMAT, BASIS, 300.0, PACE, any_pose=False)
    assert found.found.all(1).tolist() == [frame not in (3, 4) for frame in range(FRAMES)]
    assert not found.points[3:5].any()


def test_in_any_pose_points_lie_where_they_are_seen_and_as_deep_as_was_guessed():
    points, shape = scene()
    pixels, _ = project(points, K, VIEWMAT)
    wrong = shape * torch.tensor([1.4, 0.7, 1.0])  # a detector that mistakes who lies
    plain, on_rays = (
        lifted(pixels, torch.ones(FRAMES, 20), wrong, any_pose=any_pose)
        for any_pose in (False, True)
    )
    seen, depths = project(on_rays, K, VIEWMAT)
    torch.testing.assert_close(seen, pixels, rtol=0, atol=0.01)
    torch.testing.assert_close(depths, project(plain, K, VIEWMAT)[1], rtol=1e-4, atol=1e-4)
    assert (project(plain, K, VIEWMAT)[0] - pixels).norm(dim=-1).mean() > 10


def test_who_lies_is_as_far_away_as_who_stands():
    _, shape = scene()
    standing, seen, focal = shape.expand(FRAMES, -1, -1), torch.ones(FRAMES, 20), K[[0, 1], [0, 1]]
    lying = standing[..., [1, 0, 2]]
    stands = lifting._typical_depth(standing, seen, focal, 300.0, False)
    assert lifting._typical_depth(lying, seen, focal, 300.0, True) == pytest.approx(stands)
    assert lifting._typical_depth(lying, seen, focal, 300.0, False) < 0.5 * stands
