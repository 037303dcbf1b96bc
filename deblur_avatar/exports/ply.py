"""3D Gaussian splatting's PLY: one pose of an avatar, for viewers of static splats.

Conventions. One element `vertex`, binary, little-endian float32. Positions in metres in the world
of the clip; `f_dc_*` are spherical harmonics of degree 0 (colour = 0.5 + C0 f_dc, sRGB), `opacity`
is a logit, `scale_*` natural logarithms of metres, `rot_*` a quaternion wxyz.

Source: Kerbl et al., "3D Gaussian Splatting", SIGGRAPH 2023, its released point_cloud.ply.
"""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
import torch
from pydantic import Field

from deblur_avatar import run as stage
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.config.section import Params
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.posed_gaussians import PosedGaussians, posed_gaussians

C0 = 0.28209479177387814  # spherical harmonic of degree 0: 1 / (2 sqrt(pi))
MAX_OPACITY = 1 - 1e-6  # so that the logit is finite
PROPERTIES = (
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    "rot_0", "rot_1", "rot_2", "rot_3",
)  # fmt: skip


class PlyExport(Params):
    """One frame's pose, in the colours that the training camera sees."""

    suffix: ClassVar[str] = ".ply"

    format: Literal["ply"]
    frame: Annotated[int, Field(ge=0)]  # position in the clip

    def export(self, run: FittedRun, path: Path) -> None:
        """Write the avatar at the middle of this frame's exposure."""
        count = len(run.motion.timestamps)
        if self.frame >= count:
            raise ConfigError(
                f"export: frame {self.frame} of {count}; frames are counted from 0 to {count - 1}"
            )
        cameras = run.observations.cameras
        model = avatar_from_artifact(run.avatar, run.observations.body, torch.device("cpu"))
        pose = run.motion.centre.at([self.frame])
        viewmat = cameras.viewmats[run.observations.train_camera]
        stage.write_bytes(path, ply_bytes(posed_gaussians(model, pose, viewmat)))


def ply_bytes(gaussians: PosedGaussians) -> bytes:
    """A whole PLY file of these Gaussians."""
    columns = [
        gaussians.means,
        (gaussians.colors - 0.5) / C0,
        gaussians.opacities.clamp(1 - MAX_OPACITY, MAX_OPACITY).double().logit().float()[:, None],
        gaussians.scales.log(),
        gaussians.quats,
    ]
    table = torch.cat(columns, dim=1).numpy().astype("<f4")
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    header += [f"property float {name}" for name in PROPERTIES]
    return ("\n".join([*header, "end_header"]) + "\n").encode() + np.ascontiguousarray(
        table
    ).tobytes()
