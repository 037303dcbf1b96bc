"""Each damage does what it is named after and leaves the rest of the clip alone."""

import dataclasses
import math
from typing import Any

import pytest
import torch

from benchmarks.stress.damage import DAMAGES, averaged_light
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix

FRAMES, SIZE = 12, 16


@pytest.fixture
def clip(body: Body, swinging: Any, front: Cameras) -> BlurryClip:
    generator = torch.Generator().manual_seed(0)
    shape = (1, FRAMES, SIZE, SIZE)
    mattes = torch.zeros(shape, dtype=torch.uint8)
    mattes[..., 4:12, 4:12] = 200
    for frame in range(FRAMES):
        mattes[0, frame, frame, 0] = 90  # tells the frames apart
    frames = torch.randint(0, 256, (*shape, 3), generator=generator).to(torch.uint8)
    poses = swinging(FRAMES, 8.0)
    return BlurryClip(
        frames=frames, mattes=mattes, sharp_frames=frames[0], sharp_mattes=mattes[0],
        recorded=(0,), train_camera=0, cameras=front, frame_indices=tuple(range(FRAMES)),
        timestamps=torch.arange(FRAMES) / 60, exposure=0.05, averaging_space="srgb",
        held_out_from=FRAMES - 2, initial=poses, exact=poses,
    )  # fmt: skip


def damaged(clip: BlurryClip, name: str, amount: float = 0.0) -> BlurryClip:
    return DAMAGES[name](clip, amount, torch.Generator().manual_seed(1))


def changed(before: BlurryClip, after: BlurryClip) -> set[str]:
    """Names of the fields that differ."""
    names = [field.name for field in dataclasses.fields(before)]
    return {n for n in names if not _equal(getattr(before, n), getattr(after, n))}


def _equal(a: Any, b: Any) -> bool:
    if dataclasses.is_dataclass(a) and dataclasses.is_dataclass(b):
        return all(_equal(v, getattr(b, n)) for n, v in vars(a).items())
    if isinstance(a, torch.Tensor) and isinstance(b, torch.Tensor):
        return torch.equal(a, b)
    return bool(a == b)


TOUCHES = {
    "noise_iid_degrees": (6.0, {"initial"}), "noise_correlated_degrees": (6.0, {"initial"}),
    "root_noise_cm": (5.0, {"initial"}), "no_poses": (0.0, {"initial"}),
    "held_poses_frames": (3.0, {"initial"}), "wrapped_angles": (0.0, {"initial"}),
    "half_turn": (0.0, {"initial"}), "missing_poses_share": (0.3, {"initial"}),
    "shutter_times": (2.0, {"exposure"}),
    "masks_dilated_px": (2.0, {"mattes"}), "masks_eroded_px": (2.0, {"mattes"}),
    "masks_holes_share": (0.2, {"mattes"}), "masks_swapped": (3.0, {"mattes"}),
    "masks_above": (127.0, {"mattes"}), "masks_black": (1.0, {"mattes"}),
    "masks_all_black": (0.0, {"mattes"}), "gain_ramp_stops": (1.0, {"frames"}),
    "flicker_share": (0.2, {"frames"}), "clipped_at": (180.0, {"frames"}),
    "declared_linear": (1.0, {"averaging_space"}), "body_behind_camera": (0.0, {"cameras"}),
}  # fmt: skip


@pytest.mark.parametrize("name", TOUCHES)
def test_a_damage_touches_what_it_is_about_alone(clip, name):
    amount, fields = TOUCHES[name]
    assert changed(clip, damaged(clip, name, amount)) == fields


@pytest.mark.parametrize(
    "name",
    ["nan_pose_frame", "inf_pose_frame", "zero_focal", "nan_camera", "mirrored_camera"],
)
def test_what_cannot_be_is_refused_when_it_is_made(clip, name):
    with pytest.raises(ArtifactError):
        damaged(clip, name, 3.0)


def test_noise_has_the_size_asked_for(clip):
    noisy, exact = damaged(clip, "noise_iid_degrees", 6.0).initial, clip.exact
    turned = axis_angle_to_matrix(noisy.body_pose) @ axis_angle_to_matrix(exact.body_pose).mT
    trace = turned.diagonal(dim1=-1, dim2=-2).sum(-1)
    angle = torch.acos(((trace - 1) / 2).clamp(-1, 1)).square().mean().sqrt()
    assert math.degrees(float(angle)) == pytest.approx(6.0, rel=0.15)
    shifted = damaged(clip, "root_noise_cm", 5.0).initial.transl - exact.transl
    assert float(shifted.square().sum(-1).mean().sqrt()) == pytest.approx(0.05, rel=0.6)


def test_the_long_way_round_is_the_same_pose(clip):
    wrapped = damaged(clip, "wrapped_angles").initial
    torch.testing.assert_close(
        axis_angle_to_matrix(wrapped.body_pose), axis_angle_to_matrix(clip.initial.body_pose),
        atol=1e-4, rtol=0,
    )  # fmt: skip
    assert float(wrapped.body_pose.norm(dim=-1).max()) > math.pi


def test_few_frames_are_the_first_ones_of_everything(clip):
    short = damaged(clip, "first_frames", 4.0)
    assert short.frames.shape[1] == len(short.timestamps) == len(short.initial.transl) == 4
    assert short.held_out_from == 4
    torch.testing.assert_close(short.frames, clip.frames[:, :4])


def test_masks_grow_and_shrink(clip):
    area = (clip.mattes > 127).sum()
    assert (damaged(clip, "masks_dilated_px", 1.0).mattes > 127).sum() > area
    assert (damaged(clip, "masks_eroded_px", 1.0).mattes > 127).sum() < area


def test_holes_take_the_share_of_a_mask_that_was_asked_for(clip):
    area = (clip.mattes > 127).sum()
    holes = damaged(clip, "masks_holes_share", 0.2).mattes
    assert 1 - float((holes > 127).sum()) / float(area) == pytest.approx(0.2, abs=0.1)


def test_hard_masks_are_all_or_nothing(clip):
    assert set(damaged(clip, "masks_above", 127.0).mattes.unique().tolist()) == {0, 255}


def test_as_many_masks_are_swapped_as_were_asked_for(clip):
    swapped = damaged(clip, "masks_swapped", 3.0).mattes
    assert sum(not torch.equal(a, b) for a, b in zip(swapped[0], clip.mattes[0], strict=True)) == 3


def test_a_ramp_of_gain_goes_from_dark_to_bright(clip):
    ramp = damaged(clip, "gain_ramp_stops", 1.0).frames[0].float().mean((1, 2, 3))
    plain = clip.frames[0].float().mean((1, 2, 3))
    assert ramp[0] < 0.8 * plain[0]
    assert ramp[-1] > 1.1 * plain[-1]


def test_clipped_frames_have_no_code_above_the_limit(clip):
    assert int(damaged(clip, "clipped_at", 180.0).frames.max()) == 180


def test_the_averaging_space_is_linear_for_one_damage_alone():
    assert averaged_light({"averaged_linear": 1.0}) == "linear"
    assert averaged_light({"declared_linear": 1.0}) == "srgb"
