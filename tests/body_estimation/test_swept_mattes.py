import dataclasses

import torch

from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.body_estimation.swept_mattes import swept_mattes

SIZE, FRAMES = 96, 3
TIMES = torch.arange(FRAMES) / 30.0


def posed_arm(body, degrees: float, slide: float = 0.0) -> Poses:
    """A person whose left arm turns so far in a frame interval, and who slides so far, metres."""
    pose = torch.zeros(FRAMES, len(body.parents) - 1, 3)
    pose[:, 15, 2] = torch.deg2rad(torch.tensor(degrees)) * (torch.arange(FRAMES) - 1)
    place = torch.stack([slide * torch.arange(FRAMES), torch.zeros(3), torch.zeros(3)], 1)
    betas = torch.zeros(body.shape_dirs.shape[2])
    return Poses(
        betas=betas, global_orient=torch.zeros(FRAMES, 3), body_pose=pose, transl=place.float()
    )


def clip(front, exposure: float | None) -> BlurryClip:
    K = front.Ks.clone()
    K[:, :2] *= SIZE / float(front.sizes[0, 0])
    cameras = dataclasses.replace(front, Ks=K, sizes=torch.tensor([[SIZE, SIZE]]))
    return BlurryClip(
        frames=torch.zeros(1, FRAMES, SIZE, SIZE, 3, dtype=torch.uint8), mattes=None,
        sharp_frames=None, sharp_mattes=None, recorded=(0,), train_camera=0, cameras=cameras,
        frame_indices=(0, 1, 2), timestamps=TIMES, exposure=exposure, averaging_space="linear",
        held_out_from=3, initial=None, exact=None,
    )  # fmt: skip


def everywhere() -> torch.Tensor:
    return torch.full((FRAMES, SIZE, SIZE), 255, dtype=torch.uint8)


def test_a_still_body_bounds_nothing(body, front):
    mattes = swept_mattes(everywhere(), clip(front, 1 / 30), body, posed_arm(body, 0.0))
    assert (mattes == 255).all()


def test_a_fast_arm_covers_what_it_passes_for_a_part_of_the_exposure(body, front):
    moving = swept_mattes(everywhere(), clip(front, 1 / 30), body, posed_arm(body, 60.0))[1]
    assert 0 < moving.min() < 128
    assert (moving < 128).sum() > 60  # where the arm passed
    middle = slice(SIZE // 2 - 3, SIZE // 2 + 3)
    assert (moving[middle, middle] == 255).all()  # the trunk stayed


def test_halving_the_exposure_lengthens_the_share_in_which_the_arm_covers_a_pixel(body, front):
    poses = posed_arm(body, 60.0)
    long, short = (
        swept_mattes(everywhere(), clip(front, e), body, poses)[1] for e in (1 / 30, 1 / 60)
    )
    assert short.float().mean() > long.float().mean()


def test_mattes_are_never_made_longer_and_those_of_instants_are_left_alone(body, front):
    detected = torch.randint(0, 256, (FRAMES, SIZE, SIZE), dtype=torch.uint8,
                             generator=torch.Generator().manual_seed(0))  # fmt: skip
    poses = posed_arm(body, 60.0)
    assert (swept_mattes(detected, clip(front, 1 / 30), body, poses) <= detected).all()
    assert torch.equal(swept_mattes(detected, clip(front, 0.0), body, poses), detected)
    assert torch.equal(swept_mattes(detected, clip(front, None), body, poses), detected)
