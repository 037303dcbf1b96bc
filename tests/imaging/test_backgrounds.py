import logging

import pytest
import torch

from deblur_avatar.imaging.backgrounds import BackgroundEstimator, matte_edge
from deblur_avatar.imaging.matting import Plate
from tests.imaging.moving_camera import filmed, turned


def test_a_camera_that_stands_still_has_one_plate():
    frames, mattes, _ = filmed(8)
    still = frames[:1].repeat(8, 1, 1, 1)
    found = BackgroundEstimator(still).background("auto", mattes)
    assert found.kind == "median"
    assert found.one is not None
    assert found.plates is not None
    assert all(plate is found.one for plate in found.plates)


def test_a_camera_that_turns_has_a_plate_for_each_frame():
    frames, mattes, _ = filmed()
    found = BackgroundEstimator(frames).background("auto", mattes)
    assert found.kind == "aligned"
    assert found.plates is not None
    assert len(found.plates) == len(frames)
    assert found.one is None


@pytest.mark.parametrize(("degrees", "zoom"), [(3.0, 1.0), (0.0, 1.06)])
def test_a_camera_that_rolls_or_zooms_has_a_plate_for_each_frame(degrees: float, zoom: float):
    frames, mattes, behind = filmed(24, camera=turned(24, degrees, zoom))
    found = BackgroundEstimator(frames).background("auto", mattes)
    assert found.kind == "aligned"
    assert found.plates is not None
    assert _plate_error(found.plates, behind) < 2


def test_masks_without_soft_edges_have_an_edge_too():
    frames, mattes, behind = filmed()
    hard = (mattes > 0).to(torch.uint8) * 255
    found = BackgroundEstimator(frames).background("auto", hard)
    assert found.kind == "aligned"
    assert found.plates is not None
    assert _plate_error(found.plates, behind) < 8  # as in test_aligned_plates


def test_the_edge_of_a_hard_mask_is_a_pixel_on_either_side_of_it():
    matte = torch.zeros(7, 9, dtype=torch.uint8)
    matte[2:, 3:] = 255
    edge = matte_edge(matte)
    assert edge[1:, 2:4].all()
    assert edge[1:3, 2:].all()
    assert int(edge.sum()) == 12 + 14 - 4


def test_a_soft_matte_s_edge_is_its_soft_pixels():
    mattes = filmed(3)[1]
    for matte in mattes:
        assert torch.equal(matte_edge(matte), (matte > 0) & (matte < 255))


def _plate_error(plates: list[Plate], behind: torch.Tensor) -> float:
    """Mean difference from the true background where the plates are known, codes of 255."""
    apart = [
        (plate.picture.float() - true.float()).abs()[plate.known]
        for plate, true in zip(plates, behind, strict=True)
    ]
    return float(torch.cat(apart).mean())


def test_a_background_that_cannot_be_measured_is_never_taken_for_the_person(
    caplog: pytest.LogCaptureFixture,
):
    frames, mattes, _ = filmed(6)
    noise = torch.randint(0, 255, frames.shape, generator=torch.Generator().manual_seed(0))
    with caplog.at_level(logging.WARNING):
        found = BackgroundEstimator(noise.to(torch.uint8)).background("auto", mattes)
    assert found.kind == "matte"
    assert "cannot be measured" in caplog.text
    assert found.plates is not None
    assert not any(plate.known.any() for plate in found.plates)


def test_nothing_is_taken_away_where_nothing_is_behind():
    frames, mattes, _ = filmed(3)
    found = BackgroundEstimator(frames).background("none", mattes)
    assert found.plates is None
    assert found.one is None
