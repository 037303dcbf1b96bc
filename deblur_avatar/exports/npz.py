"""AMASS-style `.npz`: the fitted motion, for programs that animate SMPL's skeleton.

Conventions. `poses` [F, 72] axis-angle of SMPL's 24 joints in its order, `trans` [F, 3] metres,
`betas` shape numbers of the body that was fitted (of Anny, where the body is Anny),
`mocap_framerate` frames a second, `licence` that body's. The world has +Z up, as AMASS has; frames
are equally spaced.

Source: Mahmood et al., "AMASS", ICCV 2019, its files' keys.
"""

import io
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import torch

from deblur_avatar.animation.amass import UPRIGHT_FROM_AMASS
from deblur_avatar.animation.captured_motion import captured_motion
from deblur_avatar.config.section import Params
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.files import write_bytes
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle


class NpzExport(Params):
    """The whole clip's motion, upright, at the clip's mean frame rate."""

    suffix: ClassVar[str] = ".npz"

    format: Literal["npz"]

    def export(self, run: FittedRun, path: Path) -> None:
        """Write the poses at the middle of every exposure."""
        times, observations = run.motion.timestamps.double(), run.observations
        if len(times) < 2:
            raise ConfigError("export: a motion of one frame has no frame rate")
        seconds = float(times[-1] - times[0])
        fps = (len(times) - 1) / seconds
        motion = captured_motion(run.motion, run.stage, fps, 0.0, seconds)
        amass_from_upright = UPRIGHT_FROM_AMASS.T
        root = matrix_to_axis_angle(amass_from_upright @ axis_angle_to_matrix(motion.global_orient))
        content = io.BytesIO()
        np.savez(
            content,
            poses=torch.cat([root[:, None], motion.body_pose], dim=1).flatten(1).numpy(),
            trans=(motion.transl @ UPRIGHT_FROM_AMASS).numpy(),
            betas=run.avatar.betas.numpy(),
            mocap_framerate=np.float64(fps),
            gender=np.str_("neutral"),
            licence=np.str_(observations.body.licence),
        )
        write_bytes(path, content.getvalue())
