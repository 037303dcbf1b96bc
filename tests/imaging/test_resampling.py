import cv2
import numpy as np
import pytest
import torch

from deblur_avatar.geometry.cameras import project
from deblur_avatar.imaging.resampling import (
    crop_and_scale,
    crop_and_scale_intrinsics,
    crop_around,
    undistort,
)

pytestmark = pytest.mark.portable

K = torch.tensor([[60.0, 0, 34], [0, 60, 22], [0, 0, 1]])
LENS = torch.tensor([-0.3, 0.1, 0.01, -0.01, 0.0])


def dot_at(x: float, y: float, width: int = 64, height: int = 48) -> torch.Tensor:
    """A soft dot whose centre is at a pixel position (pixel centres at half-integers)."""
    rows, columns = np.mgrid[:height, :width] + 0.5
    dot = 255 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 18)
    return torch.from_numpy(dot.round().astype(np.uint8))[None]


def centre_of(image: torch.Tensor) -> tuple[float, float]:
    weights = image.double()
    columns = torch.arange(image.shape[1]) + 0.5
    rows = torch.arange(image.shape[0]) + 0.5
    total = weights.sum()
    return float((weights.sum(0) * columns).sum() / total), float(
        (weights.sum(1) * rows).sum() / total
    )


def test_the_whole_picture_at_its_own_size_is_unchanged():
    images = torch.randint(0, 256, (2, 6, 8, 3), dtype=torch.uint8)
    assert torch.equal(crop_and_scale(images, (0, 0, 8, 6), (8, 6)), images)


def test_scaling_down_averages_pixels():
    image = torch.tensor([[[0, 100, 10, 30], [100, 200, 50, 70]]], dtype=torch.uint8)
    assert crop_and_scale(image, (0, 0, 4, 2), (2, 1)).tolist() == [[[100, 40]]]


def test_a_crop_takes_its_own_pixels():
    image = torch.arange(48, dtype=torch.uint8).reshape(1, 6, 8)
    assert crop_and_scale(image, (5, 2, 3, 1), (3, 1)).tolist() == [[[21, 22, 23]]]


@pytest.mark.parametrize("crop", [(-1, 0, 4, 4), (0, -1, 4, 4), (5, 0, 4, 4), (0, 3, 4, 4)])
def test_a_crop_that_leaves_the_picture_is_refused(crop: tuple[int, int, int, int]):
    with pytest.raises(ValueError, match="leaves pictures of 8 x 6 pixels"):
        crop_and_scale(torch.zeros(1, 6, 8, dtype=torch.uint8), crop, (2, 2))


def test_intrinsics_follow_the_pixels():
    point, viewmat = torch.tensor([[0.1, -0.05, 1.0]]), torch.eye(4)
    before = project(point, K, viewmat)[0][0]
    crop, size = (10, 4, 50, 40), (20, 10)
    cut = crop_and_scale(dot_at(*before.tolist()), crop, size)[0]
    after = project(point, crop_and_scale_intrinsics(K, crop, size), viewmat)[0][0]
    assert centre_of(cut) == pytest.approx(after.tolist(), abs=0.05)


def test_a_lens_without_distortion_changes_nothing():
    images = dot_at(30, 20)
    assert undistort(images, K, torch.zeros(5)) is images


def test_undistorted_points_lie_where_a_pinhole_camera_sees_them():
    point = torch.tensor([[0.25, -0.15, 1.0]])
    large = torch.tensor([[600.0, 0, 340], [0, 600, 220], [0, 0, 1]])
    matrix = large.double().numpy().copy()
    matrix[:2, 2] -= 0.5  # OpenCV counts from the middle of the first pixel
    place = cv2.projectPoints(
        point.double().numpy(), np.zeros(3), np.zeros(3), matrix, LENS.double().numpy()
    )[0][0, 0]
    seen = dot_at(*(place + 0.5), 640, 480)
    straight = undistort(seen, large, LENS)[0]
    pinhole = project(point, large, torch.eye(4))[0][0].tolist()
    assert np.hypot(*(place + 0.5 - pinhole)) > 4  # the lens bends enough to matter
    assert centre_of(straight) == pytest.approx(pinhole, abs=0.05)


def test_undistortion_treats_pictures_and_mattes_alike():
    matte = dot_at(40, 30)
    picture = matte[..., None].repeat(1, 1, 1, 3)
    assert torch.equal(undistort(picture, K, LENS)[..., 1], undistort(matte, K, LENS))


def test_a_crop_holds_all_boxes_with_a_margin_inside_the_picture():
    boxes = torch.tensor([[10.0, 10, 20, 30], [15, 5, 30.5, 20]])
    assert crop_around(boxes, 0.0, (100, 100)) == (10, 5, 21, 25)
    assert crop_around(boxes, 0.2, (100, 100)) == (5, 0, 30, 35)
    assert crop_around(boxes, 0.2, (32, 33)) == (5, 0, 27, 33)


def test_boxes_outside_the_picture_are_refused():
    with pytest.raises(ValueError, match="outside 100 x 50"):
        crop_around(torch.tensor([[120.0, 10, 130, 20]]), 0.0, (100, 50))
