import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.body_estimation.body_fit import BodyFit
from deblur_avatar.body_estimation.fit_quality import measure_fit
from tests.walking_person import SIZE, detect_perfectly, ring_of_cameras, walking_poses

CAMERAS, RECORDED = ring_of_cameras(3), (0, 2)


def perfect_fit(body: Body, residual: float = 0.5) -> BodyFit:
    return BodyFit(
        walking_poses(body, 7),
        torch.full((2, 7, 21), residual),
        extent=80.0,
        trust=torch.ones(7),
        flags={},
        parts={},
    )


def mattes(body: Body) -> list[torch.Tensor]:
    poses = walking_poses(body, 7)
    return [detect_perfectly(body, poses, CAMERAS, camera).mattes for camera in RECORDED]


def test_a_body_that_fills_its_mattes_overlaps_with_them_wholly(body: Body):
    report = measure_fit(perfect_fit(body), body, CAMERAS, RECORDED, mattes(body))
    assert list(report) == ["cam0", "cam2"]
    for measured in report.values():
        assert measured["iou"] > 0.85  # silhouettes are compared at half the size
        assert measured["offset_px"] == pytest.approx([0, 0], abs=1.0)
        assert (measured["reprojection_px"], measured["agree"]) == (0.5, 1.0)


def test_a_shifted_camera_shows_in_overlap_and_offset(body: Body):
    shifted = [torch.roll(stack, (6, -4), dims=(1, 2)) for stack in mattes(body)]
    measured = measure_fit(perfect_fit(body), body, CAMERAS, RECORDED, shifted)["cam0"]
    assert measured["iou"] < 0.7
    assert measured["offset_px"] == pytest.approx([-4, 6], abs=1.0)


def test_landmarks_far_off_do_not_agree(body: Body):
    fit = perfect_fit(body)
    fit.residuals[0, :, :7] = 40.0
    measured = measure_fit(fit, body, CAMERAS, RECORDED, mattes(body))
    assert measured["cam0"]["agree"] == pytest.approx(2 / 3)
    assert measured["cam2"]["agree"] == 1.0


def test_landmarks_that_were_not_seen_are_not_counted(body: Body):
    fit = perfect_fit(body)
    fit.residuals[0, :, :20] = 0.0
    assert measure_fit(fit, body, CAMERAS, RECORDED, mattes(body))["cam0"]["agree"] == 1.0


def test_a_camera_that_saw_nothing_has_no_figures(body: Body):
    fit = perfect_fit(body, residual=0.0)
    black = [torch.zeros(7, *SIZE[::-1], dtype=torch.uint8)] * 2
    measured = measure_fit(fit, body, CAMERAS, RECORDED, black)
    assert measured["cam0"] == {
        "reprojection_px": None,
        "agree": None,
        "iou": None,
        "offset_px": None,
    }
