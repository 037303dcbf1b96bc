"""The benchmark of frames in which nobody is seen: what is hidden, and what is measured."""

import torch

from benchmarks.unseen_frames import measured, unfound
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.body_estimation.landmarks import Landmarks

FRAMES = 5
HIDDEN = torch.tensor([False, True, True, False, False])


def test_a_detector_finds_nobody_in_hidden_frames_and_the_same_in_all_others():
    person = Landmarks(
        found=torch.tensor([True, True, True, False, True]), points=torch.rand(FRAMES, 33, 2) + 1,
        visibility=torch.rand(FRAMES, 33) + 0.1, world=torch.rand(FRAMES, 33, 3) + 1,
        mattes=torch.full((FRAMES, 4, 6), 255, dtype=torch.uint8),
    )  # fmt: skip
    seen = unfound(person, HIDDEN)
    assert seen.found.tolist() == [True, False, False, False, True]
    for name in ("points", "visibility", "world", "mattes"):
        now, before = getattr(seen, name), getattr(person, name)
        assert not now[HIDDEN].any()
        assert torch.equal(now[~HIDDEN], before[~HIDDEN])
        assert now.dtype == before.dtype


def test_errors_are_those_of_hidden_frames_after_the_pelvis_is_put_in_place(body):
    def posed_by(turn: float, away: float) -> Poses:
        pose = torch.zeros(FRAMES, 23, 3)
        pose[HIDDEN, 15, 2] = turn
        pose[~HIDDEN] = 1.0 + turn
        return Poses(
            betas=torch.zeros(body.shape_dirs.shape[2]), global_orient=torch.zeros(FRAMES, 3),
            body_pose=pose, transl=torch.full((FRAMES, 3), away),
        )  # fmt: skip

    true = posed_by(0.0, 0.0)
    moved = measured(body, posed_by(0.0, 0.3), true, HIDDEN)
    assert max(moved["rooted_mm"], moved["registered_mm"], moved["turned"]) < 1e-2
    turned = measured(body, posed_by(0.5, 0.3), true, HIDDEN)
    assert turned["rooted_mm"] > 5
    assert abs(turned["turned"] - 0.5 * 57.2958 / 23) < 1e-2
