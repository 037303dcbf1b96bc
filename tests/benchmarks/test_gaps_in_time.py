"""The benchmark of gaps in time: what is left out, and what is measured."""

import pytest
import torch

from benchmarks.gaps_in_time import at, kept_frames, measured
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.body_estimation.body_fit import BodyFit
from deblur_avatar.body_estimation.landmarks import Landmarks

FRAMES = 6


def test_the_middle_is_left_out():
    assert kept_frames(FRAMES, 0) == [0, 1, 2, 3, 4, 5]
    assert kept_frames(FRAMES, 2) == [0, 1, 4, 5]
    assert kept_frames(FRAMES, 3) == [0, 4, 5]


@pytest.mark.parametrize("world", [None, torch.rand(FRAMES, 33, 3)])
def test_what_was_found_in_kept_frames_stays(world):
    person = Landmarks(
        found=torch.arange(FRAMES) != 4, points=torch.rand(FRAMES, 33, 2),
        visibility=torch.rand(FRAMES, 33), mattes=torch.arange(FRAMES)[:, None, None].byte(),
        world=world,
    )  # fmt: skip
    kept = [0, 1, 4, 5]
    seen = at(person, kept)
    assert seen.found.tolist() == [True, True, False, True]
    assert seen.mattes.flatten().tolist() == kept
    assert torch.equal(seen.points, person.points[kept])
    assert torch.equal(seen.visibility, person.visibility[kept])
    assert world is None or torch.equal(seen.world, world[kept])


def test_errors_are_those_of_the_frames_asked_for(body):
    bent = torch.zeros(FRAMES, 23, 3)
    bent[2, 15, 2] = 0.5
    still, moved = (
        Poses(
            betas=torch.zeros(body.shape_dirs.shape[2]), global_orient=torch.zeros(FRAMES, 3),
            body_pose=pose, transl=torch.zeros(FRAMES, 3),
        )
        for pose in (torch.zeros(FRAMES, 23, 3), bent)
    )  # fmt: skip
    residuals = torch.ones(1, FRAMES, 4)
    residuals[0, 2], residuals[0, :, 3] = 5.0, 0.0  # one landmark is never seen
    fit = BodyFit(moved, residuals, 1.0, torch.ones(FRAMES), {}, {})
    beside, elsewhere = (measured(body, fit, still, frames) for frames in ([2], [0, 1, 3, 4, 5]))
    assert beside["registered_mm"] > 5
    assert elsewhere["registered_mm"] < 1e-2
    assert (beside["reprojection_px"], elsewhere["reprojection_px"]) == (5.0, 1.0)
