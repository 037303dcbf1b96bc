import pytest
import torch

from deblur_avatar.geometry.cameras import (
    camera_centres,
    check_cameras,
    crop_intrinsics,
    look_at,
    pixel_rays,
    project,
)

K = torch.tensor([[100.0, 0, 31], [0, 110, 25], [0, 0, 1]]).double()
EYE = torch.tensor([1.0, 2, 5]).double()
VIEWMAT = look_at(EYE, torch.zeros(3).double(), torch.tensor([0.0, 1, 0]).double())


def test_a_point_straight_ahead_falls_on_the_principal_point():
    pixel, depth = project(torch.zeros(1, 3).double(), K, VIEWMAT)
    torch.testing.assert_close(pixel[0], K[:2, 2])
    torch.testing.assert_close(depth[0], EYE.norm())


def test_up_is_up_in_the_image():
    pixels, _ = project(torch.tensor([[0.0, 0, 0], [0, 0.1, 0]]).double(), K, VIEWMAT)
    assert pixels[1, 1] < pixels[0, 1]


def test_rays_lead_back_to_the_pixels_they_came_from():
    pixels = torch.tensor([[0.5, 0.5], [31, 25], [60, 2]]).double()
    origins, directions = pixel_rays(K, VIEWMAT, pixels)
    torch.testing.assert_close(directions.norm(dim=-1), torch.ones(3).double())
    torch.testing.assert_close(project(origins + 3 * directions, K, VIEWMAT)[0], pixels)


def test_the_camera_stands_where_it_was_put():
    torch.testing.assert_close(camera_centres(VIEWMAT), EYE)


def test_moving_world_and_camera_together_changes_nothing():
    motion = torch.eye(4).double()
    motion[:3, :3] = look_at(EYE, EYE + 1, torch.tensor([0.0, 0, 1]).double())[:3, :3]
    motion[:3, 3] = torch.tensor([3.0, -1, 2])
    points = torch.randn(5, 3).double()
    moved = points @ motion[:3, :3].T + motion[:3, 3]
    expected = project(points, K, VIEWMAT)[0]
    torch.testing.assert_close(project(moved, K, VIEWMAT @ motion.inverse())[0], expected)


def test_cropping_and_scaling_moves_pixels_as_it_moves_the_picture():
    points = torch.randn(5, 3).double()
    pixels = project(points, K, VIEWMAT)[0]
    cropped = crop_intrinsics(K, 4.0, 6.0, 0.5)
    expected = (pixels - torch.tensor([4.0, 6.0])) * 0.5
    torch.testing.assert_close(project(points, cropped, VIEWMAT)[0], expected)


def test_a_point_behind_the_camera_is_told_by_its_depth():
    behind = (EYE + EYE)[None]
    pixel, depth = project(behind, K, VIEWMAT)
    assert depth[0] < 0
    assert torch.isfinite(pixel).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda K, V: K.fill_(float("nan")), "camera 1: K and viewmat must be finite"),
        (lambda K, V: K[0, 0].zero_(), "camera 1: focal lengths must be positive"),
        (lambda K, V: V[0].neg_(), r"camera 1: det\(R\) = -1.000 mirrors the world"),
        (lambda K, V: V[:3, :3].mul_(2), "camera 1: R is not a rotation"),
    ],
)
def test_impossible_cameras_are_named(change, message):
    Ks, viewmats = torch.stack([K, K]), torch.stack([VIEWMAT, VIEWMAT])
    check_cameras(Ks, viewmats)
    change(Ks[1], viewmats[1])
    with pytest.raises(ValueError, match=message):
        check_cameras(Ks, viewmats)


def test_looking_along_up_is_refused():
    up = torch.tensor([0.0, 1, 0])
    with pytest.raises(ValueError, match="not along up"):
        look_at(up, torch.zeros(3), up)
