import torch

from deblur_avatar.geometry.cameras import camera_centres, project
from deblur_avatar.sources.studio.cameras import (
    AIM,
    DISTANCE,
    FIELD,
    place_cameras,
)


def test_the_training_camera_stands_in_front_and_the_others_all_around():
    cameras = place_cameras(8, 64)
    centres = camera_centres(cameras.viewmats)
    assert cameras.names[0] == "train"
    torch.testing.assert_close(centres[0, [0, 2]], torch.tensor([0.0, DISTANCE]))
    angles = torch.rad2deg(torch.atan2(centres[:, 0], centres[:, 2])) % 360
    torch.testing.assert_close(angles, torch.arange(9) * 40.0, atol=1e-3, rtol=0)
    assert len(centres[1:, 1].mul(100).round().unique()) == 3


def test_every_camera_sees_the_person_upright_and_in_the_middle():
    cameras = place_cameras(6, 100)
    ends = torch.tensor([[0, AIM, 0], [0, AIM + 0.8, 0], [0, AIM - 0.8, 0.0]])
    for K, viewmat in zip(cameras.Ks, cameras.viewmats, strict=True):
        (middle, top, bottom), depth = project(ends, K, viewmat)
        torch.testing.assert_close(middle, torch.tensor([50.0, 50.0]))
        assert (depth > 0).all()
        assert 0 < top[1] < bottom[1] < 100
        assert abs((bottom[1] - top[1]) / 100 - 1.6 / FIELD) < 0.04


def test_larger_images_show_the_same_finer():
    small, large = place_cameras(2, 50), place_cameras(2, 200)
    torch.testing.assert_close(small.viewmats, large.viewmats)
    torch.testing.assert_close(4 * small.Ks[:, :2], large.Ks[:, :2])
