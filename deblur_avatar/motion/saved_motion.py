"""The trajectory behind a saved motion, so that a later stage can go on with it."""

import torch

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.errors import ArtifactError
from deblur_avatar.motion.clip import ClipMotion
from deblur_avatar.motion.exposure_motions import EXPOSURE_MOTIONS
from deblur_avatar.motion.trajectory import FrameMotion, Trajectory


def trajectory_from_artifact(motion: Motion) -> Trajectory:
    """Rebuild the trajectory that a stage saved.

    Raises:
        ArtifactError: if it is of a kind that this version does not know.
    """
    trajectory: Trajectory
    if motion.kind == "clip":
        return ClipMotion.restored(motion.u, motion.parameters)
    if motion.kind in EXPOSURE_MOTIONS:
        kind = EXPOSURE_MOTIONS[motion.kind]
        trajectory = kind(motion.centre, motion.u, 0.0, torch.Generator())
    elif motion.kind in ("frame", "fixed"):
        trajectory = FrameMotion(motion.centre, refined=motion.kind == "frame")
    else:
        raise ArtifactError(f"no motion of kind {motion.kind!r} is known; run `dvc repro`")
    # Copies values: fitting works in place, and an artifact never changes.
    trajectory.load_state_dict(motion.parameters)
    return trajectory
