"""What a camera shows of the seen surface is counted and averaged over its pixels alone."""

import numpy as np
import pytest
import torch

from benchmarks.seen_surface import marked, of_camera, picture
from deblur_avatar.evaluation.comparisons import Comparison
from deblur_avatar.evaluation.truth_views import TruthView


def compared(light: int, psnr_seen: float, columns: int = 2) -> Comparison:
    """A person eight pixels wide, of whom some columns were seen; the truth has 51 of 255 there."""
    person, seen = torch.zeros(6, 8, dtype=torch.bool), torch.zeros(6, 8, dtype=torch.bool)
    person[1:5], seen[1:5, :columns] = True, True
    image, render = (torch.full((6, 8, 3), 200, dtype=torch.uint8) for _ in range(2))
    image[seen], render[seen] = 51, light
    view = TruthView(
        camera=2, position=0, novel_pose=False, viewmat=None, offset=0.0, image=image,
        foreground=person, seen=seen,
    )  # fmt: skip
    return Comparison(
        view, render, torch.ones(6, 8), torch.zeros(6, 8),
        {"psnr_seen": psnr_seen, "psnr_foreground": 20.0},
    )  # fmt: skip


def test_shares_and_brightness_are_of_the_seen_pixels_and_scores_the_methods_own():
    renders = {
        "lean": [compared(102, 10.0), compared(102, 13.0, columns=4)],
        "agnostic": [compared(0, 15.0), compared(51, 15.0, columns=4)],
    }
    row = of_camera(renders)
    assert row["views"] == 2
    assert row["seen_share"] == pytest.approx((2 + 4) / 16, abs=1e-3)
    assert row["brightness"] == pytest.approx(0.2)
    assert row["lean"] == {"psnr_seen": 11.5, "psnr_foreground": 20.0, "brightness": 0.4}
    assert row["agnostic"]["brightness"] == pytest.approx(0.2 * 4 / 6, abs=1e-3)


def test_the_picture_shows_seen_surface_truth_and_methods_a_row_a_view():
    one = [compared(102, 10.0) for _ in range(3)]
    shown = picture({"lean": one, "agnostic": [compared(0, 9.0) for _ in range(3)]})
    assert shown.shape == (2 * 3 * 6, 2 * 4 * 8, 3)
    left = marked(one[0].view.image, one[0].view.seen)
    assert left[1, 0].tolist() == [255, 40, 40]
    assert left[1, 5].tolist() == [100, 100, 100]
    assert (shown[2, 2 * 16] == 102).all()  # lean's first seen pixel
    assert np.array_equal(shown[:12, : 2 * 8], np.kron(left, np.ones((2, 2, 1), np.uint8)))
