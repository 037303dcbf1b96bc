"""Tests of features of the background: whose they are, and that a frame is searched once."""

import cv2
import numpy as np
import pytest
import torch

from deblur_avatar.imaging import background_features
from deblur_avatar.imaging.background_features import FrameFeatures, matched_scale, matches
from deblur_avatar.imaging.backgrounds import BackgroundEstimator
from deblur_avatar.imaging.camera_motion import background_mask
from tests.imaging.moving_camera import filmed


@pytest.mark.parametrize("larger", [1, 8], ids=["whole", "matched smaller"])
def test_features_are_those_that_sift_finds_beside_a_mask(larger):
    frames, mattes, _ = filmed(2)
    frames, mattes = (
        x.repeat_interleave(larger, 1).repeat_interleave(larger, 2) for x in (frames, mattes)
    )
    scale = matched_scale(*mattes.shape[1:])
    assert (scale < 1) == (larger > 1)
    detector = cv2.SIFT_create(background_features.FEATURES)
    for frame, matte, found in zip(
        frames, mattes, FrameFeatures(frames).beside(mattes), strict=True
    ):
        grey = cv2.cvtColor(frame.numpy(), cv2.COLOR_RGB2GRAY)
        mask = background_mask(matte).numpy().astype(np.uint8)
        if scale < 1:
            grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            mask = cv2.resize(mask, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
        points, descriptors = detector.detectAndCompute(grey, mask)
        every, _ = detector.detectAndCompute(grey, None)
        assert 0 < len(points) < len(every)  # the mask leaves some out
        np.testing.assert_array_equal(found.places, np.float32([point.pt for point in points]))
        np.testing.assert_array_equal(found.descriptors, descriptors)


def test_a_frame_is_searched_once_for_all_its_mattes(monkeypatch):
    frames, mattes, _ = filmed(4)
    searched = []
    search = background_features._features
    monkeypatch.setattr(
        background_features, "_features", lambda *given: searched.append(1) or search(*given)
    )
    scene = BackgroundEstimator(frames)
    scene.background("aligned", mattes)
    scene.background("aligned", torch.zeros_like(mattes))
    assert len(searched) == len(frames)


def test_frames_without_features_match_nothing():
    blank, full = torch.full((1, 40, 60, 3), 128, dtype=torch.uint8), filmed(1)
    (none,) = FrameFeatures(blank).beside(torch.zeros((1, 40, 60), dtype=torch.uint8))
    (some,) = FrameFeatures(full[0]).beside(full[1])
    assert none.places.shape == (0, 2)
    assert none.descriptors.shape == (0, 128)
    assert matches(none, some) is None
    assert matches(some, none) is None
