"""Pictures of an evaluation: renders beside the ground truth, error maps, a turntable."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.animation.placement import framed_camera, place
from deblur_avatar.animation.stage import stage_of_clip
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.evaluation.comparisons import Comparison
from deblur_avatar.evaluation.held_out_blur import reconstruct_held_out
from deblur_avatar.imaging.contact_sheets import contact_sheet
from deblur_avatar.imaging.picture_files import write_picture

Picture = UInt8[np.ndarray, "_ _ 3"]

NOVEL_VIEWS, NOVEL_POSES = 6, 2  # columns of the strip
SIDES = 8  # of the turntable
TURNTABLE_SIZE = 288  # pixels
MARGIN = 0.06  # around the person on the turntable, as a share of her height
LEFT_SHOULDER, RIGHT_SHOULDER = 15, 16  # rows of body_pose, which leaves out the root
ARMS_DOWN = 1.0  # radians below the T-pose


@dataclass(frozen=True)
class Pictures:
    """Files by name, and what the single test views show."""

    files: dict[str, Picture]
    index: list[dict[str, Any]]

    def save(self, folder: Path) -> None:
        """Write all pictures as PNG files.

        Raises:
            ArtifactError: if the disk refuses.
        """
        for name, picture in self.files.items():
            write_picture(folder / name, picture)


def draw_pictures(
    comparisons: Sequence[Comparison],
    observations: Observations,
    avatar: Avatar,
    motion: Motion,
    device: torch.device,
) -> Pictures:
    """Choose test views evenly spaced over cameras and time, the same for every method of a scene.

    Without any, blurred frames set aside take their place, beside the averaged and the sharp
    render of them.

    Returns:
        `strip.png` (renders over truths over FLIP maps), `turntable.png`, and for each view chosen
        `<camera>-<frame>-{render,truth,difference}.png` and `<frame>-blurred.png`, the frame that
        the training camera took at that time; the index tells which is which.
    """
    if not comparisons:
        held_out, index = reconstruct_held_out(avatar, motion, observations, NOVEL_VIEWS, device)
        files = {name: picture.numpy() for name, picture in held_out.items()}
        files["strip.png"] = _held_out_strip(files, index)
        files["turntable.png"] = turntable(avatar, observations, device)
        return Pictures(files, index)
    middles = [c for c in comparisons if c.view.offset == 0]  # of the frame shown beside them
    chosen = [
        *_evenly([c for c in middles if not c.view.novel_pose], NOVEL_VIEWS),
        *_evenly([c for c in middles if c.view.novel_pose], NOVEL_POSES),
    ]
    files, index = {}, []
    for comparison in chosen:
        view = comparison.view
        frame = observations.frame_indices[view.position]
        camera = observations.cameras.names[view.camera]
        names = {
            kind: f"{camera}-{frame:04d}-{kind}.png" for kind in ("render", "truth", "difference")
        }
        names["blurred"] = f"{frame:04d}-blurred.png"
        files |= {
            names["render"]: comparison.render.numpy(),
            names["truth"]: view.image.numpy(),
            names["difference"]: colour_map(comparison.difference.numpy()),
            names["blurred"]: observations.frames[view.position].numpy(),
        }
        index.append(
            {
                "camera": camera,
                "frame": frame,
                "novel_pose": view.novel_pose,
                "psnr": comparison.scores["psnr"],
                "flip": comparison.scores["flip"],
                **names,
            }
        )
    rows = ("render", "truth", "difference")
    files["strip.png"] = _strip([files[entry[kind]] for kind in rows for entry in index], index)
    files["turntable.png"] = turntable(avatar, observations, device)
    return Pictures(files, index)


def turntable(avatar: Avatar, observations: Observations, device: torch.device) -> Picture:
    """Show the avatar standing, arms half down, from all sides.

    Its networks and latent code see a pose and an angle they were not trained on.

    Raises:
        ValueError: if the training camera looks along the person's vertical.
    """
    body, camera = observations.body, observations.train_camera
    joints = len(body.parents) - 1
    body_pose = torch.zeros(SIDES, joints, 3)
    body_pose[:, LEFT_SHOULDER, 2] = -ARMS_DOWN
    body_pose[:, RIGHT_SHOULDER, 2] = ARMS_DOWN
    still = torch.zeros(SIDES, 3)
    standing = BodyMotion(fps=1.0, global_orient=still, body_pose=body_pose, transl=still)
    stage = stage_of_clip(observations, avatar.betas)
    viewmat = observations.cameras.viewmats[camera]
    turns = (SIDES - 1) / SIDES
    poses = place(standing, body, avatar.betas, stage, turns=turns, travel=0.0)
    points = posed(body, poses).vertices
    K = observations.cameras.Ks[camera]
    images, _ = render_avatar(
        avatar_from_artifact(avatar, body, device), poses,
        framed_camera(points, K, viewmat, TURNTABLE_SIZE, MARGIN),
        frame=max(observations.train),
    )  # fmt: skip
    codes = (images.cpu() * 255).round().to(torch.uint8).numpy()
    return contact_sheet(list(codes), SIDES // 2)


def colour_map(errors: Float[np.ndarray, "H W"]) -> Picture:
    """Show a FLIP map: black for no difference, over purple and orange to pale yellow for 1."""
    codes = np.rint(errors.clip(0, 1) * 255).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(codes, cv2.COLORMAP_MAGMA)[..., ::-1])


def _strip(pictures: Sequence[Picture], index: Sequence[dict[str, Any]]) -> Picture:
    """Renders in the first row, truths in the second, FLIP maps in the third."""
    labels = []
    for entry in index:
        pose = ", new pose" if entry["novel_pose"] else ""
        labels.append(f"{entry['camera']}, frame {entry['frame']}{pose}: {entry['psnr']:.1f} dB")
    labels += ["truth"] * len(index)
    labels += [f"FLIP {entry['flip']:.3f}" for entry in index]
    return contact_sheet(pictures, len(index), labels)


def _held_out_strip(files: dict[str, Picture], index: Sequence[dict[str, Any]]) -> Picture:
    """Blurred frames in the first row, averaged renders in the second, sharp ones in the third."""
    labels = [f"frame {entry['frame']}, blurred" for entry in index]
    labels += [f"averaged render: {entry['psnr']:.1f} dB" for entry in index]
    labels += ["sharp render"] * len(index)
    rows = ("blurred", "averaged", "render")
    return contact_sheet([files[e[kind]] for kind in rows for e in index], len(index), labels)


def _evenly(comparisons: Sequence[Comparison], count: int) -> list[Comparison]:
    """Some comparisons, walking through the cameras forward and through time backward.

    In opposite directions, because a person who turns as the cameras do shows all of them one side.
    """
    cameras = sorted({comparison.view.camera for comparison in comparisons})
    count = min(count, len(comparisons))
    left = sorted(comparisons, key=lambda comparison: -comparison.view.position)
    chosen: list[Comparison] = []
    for step in range(count):
        camera = cameras[step * len(cameras) // count]
        candidates = [comparison for comparison in left if comparison.view.camera == camera]
        if candidates:
            chosen.append(candidates[step * len(candidates) // count])
            left.remove(chosen[-1])
    return chosen
