"""Steps to the ceiling, on an avatar that is put beside its true place and pose."""

from dataclasses import replace

import pytest
import torch

from benchmarks.gap_steps import Cell, placed, shifts
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.errors import ArtifactError
from tests.randomness import seeded


def test_a_rigid_move_keeps_sizes(body, swinging):
    fitted = swinging(1, 30.0)
    taller = torch.zeros_like(fitted.betas)
    taller[0] = 2.0
    there = replace(
        fitted, betas=taller, global_orient=torch.tensor([[0.3, -0.5, 0.2]]),
        transl=torch.tensor([[1.0, 2.0, 3.0]]),
    )  # fmt: skip
    moved = placed(body, fitted, there)
    assert torch.equal(moved.betas, fitted.betas)
    before, after, wanted = (posed(body, pose).joints[0] for pose in (fitted, moved, there))
    torch.testing.assert_close(torch.cdist(after, after), torch.cdist(before, before))
    torch.testing.assert_close(after.mean(0), wanted.mean(0))
    again = placed(body, moved, replace(there, betas=fitted.betas))
    torch.testing.assert_close(again.global_orient, there.global_orient, atol=1e-4, rtol=0)


def test_a_picture_is_among_its_shifts_and_so_is_one_that_was_moved_by_a_pixel():
    picture = torch.rand(12, 16, 3, generator=seeded())
    inside = (slice(3, -3), slice(3, -3))
    moved = shifts(picture)
    for wanted in (picture, picture.roll(1, 0), picture.roll((-2, 1), (0, 1))):
        away = [float((one - wanted)[inside].abs().max()) for one in moved]
        assert min(away) < 1e-4


@pytest.fixture
def steps(scene):
    """Of the scene's avatar, its motion changed."""

    def of(known: bool = True, **changes):
        motion = replace(scene.motion, centre=replace(scene.motion.centre, **changes))
        reference = scene.reference if known else replace(scene.reference, motion=None)
        return Cell.of(scene.avatar, motion, scene.observations, reference).steps()

    return of


def test_each_step_takes_out_what_it_is_named_after(scene, steps):
    centre, right = scene.motion.centre, steps()
    assert right["fitted"] == pytest.approx(right["poses"], abs=0.02)
    assert right["placed"] == pytest.approx(right["poses"], abs=0.02)
    assert right["poses"] <= right["shifted"]
    beside = steps(transl=centre.transl + torch.tensor([0.05, 0.0, 0.1]))
    assert beside["fitted"] < right["fitted"] - 2
    assert beside["placed"] == pytest.approx(right["placed"], abs=0.02)
    assert beside["poses"] == right["poses"]
    bent = steps(body_pose=centre.body_pose + 0.3)
    assert bent["placed"] < bent["poses"] - 2
    assert bent["poses"] == right["poses"]


def test_scenes_without_true_poses_are_refused(steps):
    with pytest.raises(ArtifactError, match="knows no true poses"):
        steps(known=False)
