"""Input damage: what goes wrong with a blurred clip before `preprocess`, by name and amount.

Conventions. A damage takes the clip, its amount (what that counts is said below) and a generator,
and gives the clip damaged. The truth that evaluation compares with stays as it was.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear
from deblur_avatar.sources.missing_poses import fill_missing
from deblur_avatar.sources.studio.motion import Moves
from deblur_avatar.sources.studio.noise import disturb

CORRELATION_S = 0.1  # of pose noise that drifts, as estimators' does
FLICKER_HZ = 100.0  # of lamps on a 50 Hz net

Damage = Callable[[BlurryClip, float, torch.Generator], BlurryClip]
Masks = Callable[[UInt8[Tensor, "F H W"], float, torch.Generator], UInt8[Tensor, "F H W"]]


def averaged_light(damage: Mapping[str, float]) -> Literal["srgb", "linear"]:
    """In which light the blur of a clip with this damage is averaged."""
    return "linear" if "averaged_linear" in damage else "srgb"


# --- poses: degrees, centimetres, a share of the frames ------------------------------------------


def _exact(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    return dataclasses.replace(clip, initial=clip.exact)


def _noise(correlation_s: float, degrees: bool) -> Damage:
    def damage(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
        exact = clip.exact
        assert exact is not None
        true = Moves(exact.global_orient.double(), exact.body_pose.double(), exact.transl.double())
        turns, shifts = (amount, 0.0) if degrees else (1.5, 10 * amount)
        wrong = disturb(true, clip.timestamps, turns, shifts, correlation_s, generator)
        return dataclasses.replace(clip, initial=wrong.poses(exact.betas))

    return damage


def _missing(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """Some frames have no pose, which sources fill in."""
    poses = clip.initial
    assert poses is not None
    lost = torch.rand(len(poses.transl), generator=generator) < amount
    turns = poses.axis_angle
    turns, transl = fill_missing(
        turns.masked_fill(lost[:, None, None], math.nan),
        poses.transl.masked_fill(lost[:, None], math.nan),
        "the clip",
    )
    filled = dataclasses.replace(
        poses, global_orient=turns[:, 0], body_pose=turns[:, 1:], transl=transl
    )
    return dataclasses.replace(clip, initial=filled)


def _none(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    return dataclasses.replace(clip, initial=None)


def _held(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """Poses stand still for `amount` frames, then jump: no velocity to start from."""
    assert clip.initial is not None
    frames = torch.arange(len(clip.timestamps))
    return dataclasses.replace(clip, initial=clip.initial.at(frames // int(amount) * int(amount)))


def _wrapped(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """Every second frame's rotations the long way round: the same pose, the other quaternion."""
    poses = clip.initial
    assert poses is not None
    odd = torch.arange(len(poses.transl)) % 2 == 1

    def around(turns: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
        angle = turns.norm(dim=-1, keepdim=True)
        longer = turns * (1 - 2 * math.pi / angle.clamp(min=1e-6))
        return torch.where(angle > 1e-3, longer, turns)

    orient, pose = poses.global_orient.clone(), poses.body_pose.clone()
    orient[odd], pose[odd] = around(orient[odd]), around(pose[odd])
    return dataclasses.replace(
        clip, initial=dataclasses.replace(poses, global_orient=orient, body_pose=pose)
    )


def _half_turn(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """The wrists given as turned by exactly 180 degrees about the forearm."""
    poses = clip.initial
    assert poses is not None
    pose = poses.body_pose.clone()
    pose[:, 19:21] = torch.tensor([math.pi, 0.0, 0.0])
    return dataclasses.replace(clip, initial=dataclasses.replace(poses, body_pose=pose))


def _bad_pose(value: float) -> Damage:
    def damage(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
        assert clip.initial is not None
        transl = clip.initial.transl.clone()
        transl[int(amount)] = value
        return dataclasses.replace(clip, initial=dataclasses.replace(clip.initial, transl=transl))

    return damage


# --- frames: how many ----------------------------------------------------------------------------


def _first_frames(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    chosen = slice(0, int(amount))
    assert clip.sharp_frames is not None
    assert clip.initial is not None
    assert clip.exact is not None
    assert clip.mattes is not None
    assert clip.sharp_mattes is not None
    return dataclasses.replace(
        clip,
        frames=clip.frames[:, chosen],
        mattes=clip.mattes[:, chosen],
        sharp_frames=clip.sharp_frames[chosen],
        sharp_mattes=clip.sharp_mattes[chosen],
        frame_indices=clip.frame_indices[chosen],
        timestamps=clip.timestamps[chosen],
        held_out_from=int(amount),
        initial=clip.initial.at(chosen),
        exact=clip.exact.at(chosen),
    )


def _shutter(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """The exposure is said to be `amount` times what it was."""
    assert clip.exposure is not None
    return dataclasses.replace(clip, exposure=clip.exposure * amount)


# --- masks: pixels, shares, counts of frames, codes ----------------------------------------------


def _masks(change: Masks) -> Damage:
    def damage(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
        assert clip.mattes is not None
        changed = change(clip.mattes[0].clone(), amount, generator)
        return dataclasses.replace(clip, mattes=changed[None])

    return damage


def _morphed(operation: int) -> Masks:
    def change(
        masks: UInt8[Tensor, "F H W"], amount: float, generator: torch.Generator
    ) -> UInt8[Tensor, "F H W"]:
        size = 2 * int(amount) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        changed = [cv2.morphologyEx(mask, operation, disc) for mask in masks.numpy()]
        return torch.from_numpy(np.stack(changed))

    return change


def _holes(
    masks: UInt8[Tensor, "F H W"], amount: float, generator: torch.Generator
) -> UInt8[Tensor, "F H W"]:
    """Squares of 4 pixels fall out of the masks, another set in each frame."""
    lost: Bool[Tensor, "F h w"] = (
        torch.rand(len(masks), *(-(-s // 4) for s in masks.shape[1:]), generator=generator) < amount
    )
    spread = lost.repeat_interleave(4, 1).repeat_interleave(4, 2)
    return masks.masked_fill(spread[:, : masks.shape[1], : masks.shape[2]], 0)


def _swapped(
    masks: UInt8[Tensor, "F H W"], amount: float, generator: torch.Generator
) -> UInt8[Tensor, "F H W"]:
    """So many masks are those of frames half a clip away."""
    wrong = torch.randperm(len(masks), generator=generator)[: int(amount)]
    masks[wrong] = masks[(wrong + len(masks) // 2) % len(masks)].clone()
    return masks


def _above(
    masks: UInt8[Tensor, "F H W"], amount: float, generator: torch.Generator
) -> UInt8[Tensor, "F H W"]:
    """All or nothing, above this code."""
    return (masks > amount).to(torch.uint8) * 255


def _black(
    masks: UInt8[Tensor, "F H W"], amount: float, generator: torch.Generator
) -> UInt8[Tensor, "F H W"]:
    """Masks from the second frame on, so many, find nobody."""
    masks[1 : 1 + int(amount)] = 0
    return masks


def _all_black(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    assert clip.mattes is not None
    return dataclasses.replace(clip, mattes=torch.zeros_like(clip.mattes))


# --- pictures: what is in them beside the person -------------------------------------------------


def _surroundings(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """A room of this brightness stands behind the person, and nothing takes it away."""
    assert clip.mattes is not None
    cells = torch.rand(3, 12, 12, generator=generator) * amount
    room = torch.nn.functional.interpolate(cells[None], clip.frames.shape[2:4], mode="bilinear")[0]
    clear = 1 - clip.mattes.float()[..., None] / 255
    mixed = clip.frames.float() + clear * 255 * room.permute(1, 2, 0)
    return dataclasses.replace(clip, frames=mixed.round().clamp(0, 255).to(torch.uint8))


def _neighbour(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """Somebody stands this many pixels to the right, alike, and inside the masks."""
    assert clip.mattes is not None
    frames, mattes = (torch.roll(part, int(amount), 3) for part in (clip.frames, clip.mattes))
    behind = clip.mattes[..., None] == 0
    return dataclasses.replace(
        clip,
        frames=torch.where(behind, frames, clip.frames),
        mattes=torch.maximum(mattes, clip.mattes),
    )


# --- light: stops, shares, codes -----------------------------------------------------------------


def _ramp(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """From `amount` stops too dark at the first frame to as many too bright at the last."""
    stops = torch.linspace(-amount, amount, len(clip.timestamps))
    return _lit(clip, 2**stops)


def _flicker(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """Each frame's light is off by up to this share, as under lamps on the mains."""
    phase = torch.sin(2 * torch.pi * FLICKER_HZ * clip.timestamps + 0.7)
    return _lit(clip, 1 + amount * phase)


def _lit(clip: BlurryClip, gains: Float[Tensor, " F"]) -> BlurryClip:
    light = srgb_to_linear(clip.frames.float() / 255) * gains[:, None, None, None]
    codes = (linear_to_srgb(light.clamp(0, 1)) * 255).round().to(torch.uint8)
    return dataclasses.replace(clip, frames=codes)


def _clipped(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """No code above this one; what was brighter is lost."""
    return dataclasses.replace(clip, frames=clip.frames.clamp(max=int(amount)))


def _averaged(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """Averaged in linear light (`averaged_light`), but said to be averaged as sRGB."""
    return dataclasses.replace(clip, averaging_space="srgb")


def _declared(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    return dataclasses.replace(clip, averaging_space="linear")


# --- cameras -------------------------------------------------------------------------------------


def _camera(field: str, index: tuple[int, ...], value: Callable[[float], float]) -> Damage:
    """One number of the training camera is another."""

    def damage(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
        changed = getattr(clip.cameras, field).clone()
        place = (clip.train_camera, *index)
        changed[place] = value(float(changed[place]))
        return dataclasses.replace(
            clip, cameras=dataclasses.replace(clip.cameras, **{field: changed})
        )

    return damage


def _focal(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """The focal length is said to be so many times what it is."""
    Ks = clip.cameras.Ks.clone()
    Ks[:, 0, 0] *= amount
    Ks[:, 1, 1] *= amount
    return dataclasses.replace(clip, cameras=dataclasses.replace(clip.cameras, Ks=Ks))


def _mirrored(clip: BlurryClip, amount: float, generator: torch.Generator) -> BlurryClip:
    """A left-handed camera: its rotation's determinant is -1."""
    viewmats = clip.cameras.viewmats.clone()
    viewmats[clip.train_camera, 0] *= -1
    return dataclasses.replace(clip, cameras=dataclasses.replace(clip.cameras, viewmats=viewmats))


DAMAGES: dict[str, Damage] = {
    "exact_poses": _exact,
    "noise_iid_degrees": _noise(0.0, degrees=True),
    "noise_correlated_degrees": _noise(CORRELATION_S, degrees=True),
    "root_noise_cm": _noise(CORRELATION_S, degrees=False),
    "missing_poses_share": _missing,
    "no_poses": _none,
    "held_poses_frames": _held,
    "wrapped_angles": _wrapped,
    "half_turn": _half_turn,
    "nan_pose_frame": _bad_pose(math.nan),
    "inf_pose_frame": _bad_pose(math.inf),
    "first_frames": _first_frames,
    "shutter_times": _shutter,
    "masks_dilated_px": _masks(_morphed(cv2.MORPH_DILATE)),
    "masks_eroded_px": _masks(_morphed(cv2.MORPH_ERODE)),
    "masks_holes_share": _masks(_holes),
    "masks_swapped": _masks(_swapped),
    "masks_above": _masks(_above),
    "masks_black": _masks(_black),
    "masks_all_black": _all_black,
    "surroundings": _surroundings,
    "neighbour_px": _neighbour,
    "gain_ramp_stops": _ramp,
    "flicker_share": _flicker,
    "clipped_at": _clipped,
    "averaged_linear": _averaged,
    "declared_linear": _declared,
    "focal_times": _focal,
    "zero_focal": _camera("Ks", (0, 0), lambda _: 0.0),
    "nan_camera": _camera("viewmats", (0, 0), lambda _: math.nan),
    "mirrored_camera": _mirrored,
    "body_behind_camera": _camera("viewmats", (2, 3), lambda depth: -depth),
}
