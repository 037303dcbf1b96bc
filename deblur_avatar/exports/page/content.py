"""Content of an avatar page: rigs, motions, the filming camera, a few filmed and sharp frames.

What a page must hold comes first; frames are as many and as good as the room that is left allows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.animation.retargeting import LOOSE, MIN_BEND, STANDING
from deblur_avatar.animation.rig_names import NAMES as RIG_NAMES
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.page.packing import (
    Packed,
    influences,
    packed_text,
    quantised,
    signed,
    spatial_order,
)
from deblur_avatar.exports.rigged import RiggedAvatar
from deblur_avatar.exports.shown_motion import ShownMotion
from deblur_avatar.geometry.cameras import camera_centres
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, axis_angle_to_quat
from deblur_avatar.geometry.skinning import invert_rigid
from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.readers.picture_codec import encoded
from deblur_avatar.rendering import conventions

MOST_INFLUENCES = 8  # joints that move a Gaussian; Anny's vertices blend to 5
# 2 um over 2 m, so that Gaussians keep their order in depth (with 16 bits some pictures lose 6 dB);
# a thousandth of a scale; a quarter of an 8-bit colour's rounding error.
BITS = {"means": 20, "quats": 14, "log_scales": 12, "opacities": 12, "colors": 12, "weights": 14,
    "turns": 16}  # fmt: skip
FRAMING_POSES = 16  # looked at to find what holds the person throughout
MOST_LARGER = 1.3  # times the filmed motion that a view is wide at first, for motions that go far
LONGEST_SHUTTER = 0.1  # seconds that the slider reaches at least
# Of WebP. 80 is 0.1 to 1.3 dB less near to the frames than JPEG of 90, in 40 to 48 % of its bytes.
QUALITIES = (80, 65, 50, 40, 30)
SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)  # of the frames asked for, where no quality is low enough
BEYOND_EXPOSURE = 1.5  # times the filmed exposure that it reaches


@dataclass(frozen=True)
class Shown:
    """One avatar of the page, and what it does."""

    run: FittedRun
    rig: RiggedAvatar
    motions: Sequence[ShownMotion]


def page_payload(shown: Sequence[Shown], pictures: int, room: int | None) -> str:
    """All numbers of a page as text.

    Args:
        shown: the avatars; the first one's film, camera and first motion are the page's.
        pictures: filmed frames to take along, evenly spaced, and the sharp ones of the same
            instants where the first one knows them; fewer if there is no room for them.
        room: the text's length at most, unless it is longer without any picture; None: any.

    Raises:
        ConfigError: if the camera looked along the person's vertical.
    """
    first = shown[0]
    arrays: dict[str, Packed] = {}
    for index, avatar in enumerate(shown):
        arrays |= {f"avatar{index}.{name}": a for name, a in _avatar_arrays(avatar).items()}
    header = {
        "name": " | ".join(avatar.run.name for avatar in shown),
        "limits": {
            "eps2d": conventions.EPS2D,
            "near_plane": conventions.NEAR_PLANE,
            "view_margin": conventions.VIEW_MARGIN,
            "max_alpha": conventions.MAX_ALPHA,
            "min_alpha": conventions.MIN_ALPHA,
        },
        "scene": _scene(first),
        # Of skeletons in files that are opened on the page.
        "rig_rules": {
            "names": RIG_NAMES,
            "standing": STANDING,
            "min_bend": MIN_BEND,
            "loose": LOOSE,
        },
        "avatars": [_avatar_header(avatar) for avatar in shown],
    }
    for taken, files in _frames(first.run, pictures):
        frames = [_about_frame(first.run, index) for index in taken]
        text = packed_text({**header, "frames": frames}, arrays | files)
        if room is None or len(text) <= room:
            break
    return text


def _avatar_header(shown: Shown) -> dict[str, Any]:
    rig, body = shown.rig, shown.run.observations.body
    canonical_from_rest = invert_rigid(rig.rest_from_canonical)
    turned = canonical_from_rest[:, :3, :3] @ rig.joints[:, :, None]
    return {
        "name": shown.run.name,
        "count": len(rig.means),
        "averaging_space": rig.averaging_space,
        "parents": body.parents,
        "joint_names": body.joint_names,
        "joints": rig.joints.flatten().tolist(),
        "canonical_joints": (turned[..., 0] + canonical_from_rest[:, :3, 3]).flatten().tolist(),
        "rest_from_canonical": rig.rest_from_canonical[:, :3].flatten().tolist(),
        "placement": _placement(shown.run),
        "motions": [{"name": motion.name, "label": motion.label} for motion in shown.motions],
    }


def _avatar_arrays(shown: Shown) -> dict[str, Packed]:
    rig = shown.rig
    order = spatial_order(rig.means.numpy())
    quats = rig.quats * torch.where(rig.quats[:, :1] < 0, -1.0, 1.0)  # the same rotation
    weights, bones = influences(rig.lbs_weights.numpy()[order], MOST_INFLUENCES, BITS["weights"])
    arrays = {
        "means": quantised(rig.means.numpy()[order], BITS["means"]),
        "quats": signed(quats.numpy()[order], BITS["quats"]),
        "log_scales": quantised(rig.log_scales.numpy()[order], BITS["log_scales"]),
        "opacities": quantised(rig.opacities[:, None].numpy()[order], BITS["opacities"]),
        "colors": quantised(rig.colors.numpy()[order], BITS["colors"]),
        "weights": weights,
        "bones": bones,
    }
    for index, motion in enumerate(shown.motions):
        turns = axis_angle_to_quat(motion.poses.axis_angle).flatten(1)
        arrays |= {
            f"motion{index}.times": Packed(motion.times.float()[:, None].numpy()),
            f"motion{index}.quats": signed(turns.numpy(), BITS["turns"]),
            f"motion{index}.transl": Packed(motion.poses.transl.numpy()),
        }
    return arrays


def _scene(shown: Shown) -> dict[str, Any]:
    """Where the person is, how large, and who filmed it."""
    observations = shown.run.observations
    camera = observations.camera
    points = _places(shown, shown.motions[0])
    world_from_stage = shown.run.stage.world_from_stage
    on_stage = points @ world_from_stage
    middle = (on_stage.min(0).values + on_stage.max(0).values) / 2
    own = _half_size(on_stage - middle)
    others = [_places(shown, motion) @ world_from_stage - middle for motion in shown.motions[1:]]
    largest = torch.stack([own, *map(_half_size, others)]).amax(0)
    away = camera_centres(camera.viewmat) @ world_from_stage - middle
    exposure = shown.run.motion.exposure(observations.exposure) or 0.0
    return {
        "world_from_stage": world_from_stage.flatten().tolist(),
        "target": (world_from_stage @ middle).tolist(),
        "distance": float(away.norm()),
        "elevation": float(torch.atan2(away[1], away[[0, 2]].norm())),
        "half_size": torch.minimum(largest, MOST_LARGER * own).tolist(),
        "camera": {
            "K": camera.K.flatten().tolist(),
            "viewmat": camera.viewmat.flatten().tolist(),
            "size": [camera.width, camera.height],
        },
        "exposure": exposure,
        "longest_shutter": max(LONGEST_SHUTTER, BEYOND_EXPOSURE * exposure),
    }


def _placement(run: FittedRun) -> dict[str, list[float]]:
    """Where and facing whom the person does what was not filmed."""
    stage = run.stage
    return {
        "anchor": stage.anchor.tolist(),
        "world_from_stage": stage.world_from_stage.flatten().tolist(),
    }


def _half_size(points: Float[Tensor, "points 3"]) -> Float[Tensor, " 2"]:
    """How far points are from the vertical axis, and above or below the middle."""
    return torch.stack([points[:, [0, 2]].norm(dim=1).max(), points[:, 1].abs().max()])


def _places(shown: Shown, motion: ShownMotion) -> Float[Tensor, "points 3"]:
    """Where Gaussians are in some poses of a motion."""
    poses = motion.poses
    step = -(-len(poses.transl) // FRAMING_POSES)
    some = poses.at(slice(None, None, step))
    rotations = axis_angle_to_matrix(some.axis_angle)
    transforms = shown.rig.model.transforms(rotations, some.transl)
    blended = torch.einsum("nj,sjrc->snrc", shown.rig.lbs_weights, transforms[:, :, :3])
    places = (blended[..., :3] @ shown.rig.means[:, :, None])[..., 0] + blended[..., 3]
    return places.flatten(0, 1)


def _about_frame(run: FittedRun, index: int) -> dict[str, Any]:
    """Number and time of a frame, in seconds after the first."""
    times = run.motion.timestamps.double()
    return {
        "number": run.observations.frame_indices[index],
        "seconds": float((times[index] - times[0]).float()),
        "kind": "image/webp",
    }


def _frames(run: FittedRun, count: int) -> Iterator[tuple[list[int], dict[str, Packed]]]:
    """Which frames go along, and their files: the most and best first, none last."""
    for share in SHARES:
        taken = evenly_spaced(range(len(run.observations.frames)), int(share * count))
        for quality in QUALITIES if taken else QUALITIES[:1]:
            files = _picture_files("frame", run.observations, taken, quality)
            if run.sharp is not None:
                files |= _picture_files("truth", run.sharp, taken, quality)
            yield taken, files


def _picture_files(
    name: str, observations: Observations, taken: Sequence[int], quality: int
) -> dict[str, Packed]:
    """Frames as WebP files, numbered in their order on the page."""
    frames, webp = observations.comparable_frames(), {"Compression": f"webp:{quality}"}
    files = (encoded(frames[index].numpy(), ".webp", webp) for index in taken)
    return {
        f"{name}{number}": Packed(np.frombuffer(file, np.uint8)[:, None])
        for number, file in enumerate(files)
    }
