import pytest
import torch

from deblur_avatar.body_estimation.triangulation import triangulate
from deblur_avatar.geometry.cameras import look_at, project

FRAMES, LANDMARKS = 3, 5
EYES = ((0.0, 0.3, 4.0), (3.5, 0.0, 2.0), (-3.5, 0.5, 2.0), (0.5, 0.2, -4.0))
K = torch.tensor([[400.0, 0, 200], [0, 400, 150], [0, 0, 1]])


def points() -> torch.Tensor:
    generator = torch.Generator().manual_seed(5)
    return torch.randn(FRAMES, LANDMARKS, 3, generator=generator) * 0.5


def rig() -> tuple[torch.Tensor, torch.Tensor]:
    up = torch.tensor([0.0, 1.0, 0.0])
    viewmats = torch.stack([look_at(torch.tensor(eye), torch.zeros(3), up) for eye in EYES])
    return K.repeat(len(EYES), 1, 1), viewmats


def seen(world: torch.Tensor) -> torch.Tensor:
    return torch.stack([project(world, *camera)[0] for camera in zip(*rig(), strict=True)])


def certain() -> torch.Tensor:
    return torch.ones(len(EYES), FRAMES, LANDMARKS)


def test_points_are_found_where_they_are():
    found = triangulate(seen(points()), certain(), *rig(), tolerance=5.0)
    assert found.found.all()
    assert (found.points - points()).abs().max() < 1e-4
    assert found.residuals.max() < 1e-2


def test_a_view_that_mistakes_left_for_right_is_outvoted():
    pixels = seen(points())
    pixels[1] = pixels[1].flip(1)
    found = triangulate(pixels, certain(), *rig(), tolerance=5.0)
    assert (found.points - points()).abs().max() < 1e-4
    swapped = (pixels[1] - seen(points())[1]).norm(dim=-1) > 5
    assert swapped.sum() >= 10
    assert torch.equal(found.inliers[1], ~swapped)
    assert found.inliers[[0, 2, 3]].all()


def test_noise_is_averaged_over_the_views_that_agree():
    generator = torch.Generator().manual_seed(1)
    noisy = seen(points()) + torch.randn(4, FRAMES, LANDMARKS, 2, generator=generator)
    by_all = triangulate(noisy, certain(), *rig(), tolerance=10.0).points
    by_two = triangulate(noisy[:2], certain()[:2], *(part[:2] for part in rig()), tolerance=10.0)
    assert (by_all - points()).norm(dim=-1).mean() < 0.8 * (by_two.points - points()).norm(
        dim=-1
    ).mean()


def test_a_view_without_confidence_has_no_say():
    pixels, confidences = seen(points()), certain()
    pixels[2] += 3.0
    confidences[2] = 0
    found = triangulate(pixels, confidences, *rig(), tolerance=50.0)
    assert (found.points - points()).abs().max() < 1e-4
    assert found.residuals[2].max() == 0


def test_what_one_view_alone_sees_is_not_found():
    confidences = certain()
    confidences[1:, 1, 2] = 0
    found = triangulate(seen(points()), confidences, *rig(), tolerance=5.0)
    missing = torch.ones(FRAMES, LANDMARKS, dtype=torch.bool)
    missing[1, 2] = False
    assert torch.equal(found.found, missing)
    assert found.points[1, 2].abs().max() == 0


def test_moving_world_and_cameras_together_changes_nothing_in_the_pictures():
    Ks, viewmats = rig()
    moved = torch.eye(4)
    moved[:3, :3] = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    moved[:3, 3] = torch.tensor([1.0, -2, 3])
    found = triangulate(seen(points()), certain(), Ks, viewmats @ torch.linalg.inv(moved), 5.0)
    expected = points() @ moved[:3, :3].T + moved[:3, 3]
    assert (found.points - expected).abs().max() < 1e-4


def test_one_view_is_refused():
    with pytest.raises(ValueError, match="two views, got 1"):
        triangulate(seen(points())[:1], certain()[:1], *(part[:1] for part in rig()), 5.0)
