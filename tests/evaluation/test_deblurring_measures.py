import math

import pytest
import torch

from deblur_avatar.evaluation.deblurring_measures import deblurring_measures
from deblur_avatar.imaging.deblurring.deblurrer import Pictures, codes_of, values_of


def pictures(colors, matte) -> Pictures:
    """Two frames of one row of pixels."""
    frames = torch.tensor(colors, dtype=torch.uint8)[:, None, :, None].expand(-1, -1, -1, 3)
    return Pictures(frames.contiguous(), torch.tensor(matte, dtype=torch.uint8)[:, None])


def db(*errors: float) -> float:
    """PSNR of errors in codes."""
    return -10 * math.log10(sum((error / 255) ** 2 for error in errors) / len(errors))


def test_the_person_is_what_the_sharp_or_the_given_matte_shows():
    sharp = pictures([[50, 60, 70, 80]] * 2, [[0, 255, 0, 0]] * 2)
    given = pictures([[90, 90, 90, 90]] * 2, [[0, 0, 9, 0]] * 2)
    made = pictures([[51, 62, 74, 88], [50, 60, 71, 81]], [[0, 245, 20, 0], [0, 255, 0, 5]])
    found = deblurring_measures(made, given, sharp)
    assert found["psnr"].tolist() == pytest.approx([db(1, 2, 4, 8), db(0, 0, 1, 1)])
    assert found["psnr_person"].tolist() == pytest.approx([db(2, 4), db(0, 1)])
    assert found["psnr_matte"].tolist() == pytest.approx([db(0, 10, 20, 0), db(0, 0, 0, 5)])


def test_codes_and_values_are_each_others():
    codes = torch.arange(256, dtype=torch.uint8)
    assert torch.equal(codes_of(values_of(codes)), codes)
    assert values_of(codes)[[0, 255]].tolist() == [0.0, 1.0]
    assert codes_of(torch.tensor([0.4 / 255, 0.6 / 255])).tolist() == [0, 1]
