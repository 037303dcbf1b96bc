"""Rigged avatar as numpy arrays: all that posing it takes, for one's own programs.

Conventions. The world of the clip, metres; quaternions wxyz; canonical Gaussians with standard
deviations and opacities as they are drawn; colours in `averaging_space`. `rest_from_canonical` and
a motion's rotations pose them as docs/exports.md says in ten lines of numpy.
"""

import io
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.rigged import rigged_avatar
from deblur_avatar.exports.shown_motion import MotionExport, shown_motions
from deblur_avatar.files import write_bytes
from deblur_avatar.geometry.rotations import axis_angle_to_quat


class RigArraysExport(MotionExport):
    """Gaussians, joints, weights and motions."""

    suffix: ClassVar[str] = ".npz"

    format: Literal["rig_arrays"]

    def export(self, run: FittedRun, path: Path) -> None:
        """Write one file with all arrays."""
        rig, body = rigged_avatar(run), run.observations.body
        arrays = {
            "means": rig.means.numpy(),
            "quats": rig.quats.numpy(),
            "scales": rig.log_scales.exp().numpy(),
            "opacities": rig.opacities.numpy(),
            "colors": rig.colors.numpy(),
            "averaging_space": np.str_(rig.averaging_space),
            "lbs_weights": rig.lbs_weights.numpy(),
            "joints": rig.joints.numpy(),
            "parents": np.array(body.parents),
            "joint_names": np.array(body.joint_names),
            "rest_from_canonical": rig.rest_from_canonical.numpy(),
            "licence": np.str_(body.licence),
        }
        for motion in shown_motions(run, self.motions, self.fps, self.seconds):
            arrays |= {
                f"{motion.name}_times": motion.times.float().numpy(),
                f"{motion.name}_quats": axis_angle_to_quat(motion.poses.axis_angle).numpy(),
                f"{motion.name}_transl": motion.poses.transl.numpy(),
            }
        content = io.BytesIO()
        np.savez(content, **arrays)  # type: ignore[arg-type]
        write_bytes(path, content.getvalue())
