"""3D Gaussian splatting's PLY: one pose of an avatar, or one file a frame of a motion.

Conventions. One element `vertex`, binary, little-endian float32. The person stands upright with
+Y down, as readers of such files expect (`upright.py`); metres. `f_dc_*` are spherical harmonics of
degree 0 (colour = 0.5 + C0 f_dc, sRGB), `opacity` is a logit, `scale_*` natural logarithms of
metres, `rot_*` a quaternion wxyz.

Source: Kerbl et al., "3D Gaussian Splatting", SIGGRAPH 2023, its released point_cloud.ply.
"""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
import torch
from pydantic import Field

from deblur_avatar.config.section import Params, Positive
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.posed_gaussians import PosedGaussians, posed_frame, posed_motion
from deblur_avatar.exports.shown_motion import even_motion
from deblur_avatar.exports.upright import upright_of
from deblur_avatar.files import write_bytes

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
        write_bytes(path, frame_as_ply(run, self.frame))


class PlySequenceExport(Params):
    """A motion as a folder of numbered PLY files, equally spaced in time."""

    suffix: ClassVar[str] = ""

    format: Literal["ply_sequence"]
    motion: str  # own, builtin:<name> or a file
    fps: Positive  # of a motion that was not filmed
    seconds: Positive  # longest duration of it

    def export(self, run: FittedRun, path: Path) -> None:
        """Write one file a frame, `frame_0000.ply` and on."""
        motion, _ = even_motion(run, self.motion, self.fps, self.seconds)
        axes = upright_of(run).for_splats()
        for index, gaussians in enumerate(posed_motion(run, motion.poses)):
            write_bytes(path / f"frame_{index:04d}.ply", ply_bytes(axes.gaussians(gaussians), run))


def frame_as_ply(run: FittedRun, frame: int) -> bytes:
    """A filmed frame's pose as a whole PLY file.

    Raises:
        ConfigError: if there is no such frame, or the avatar has no Gaussians.
    """
    return ply_bytes(upright_of(run).for_splats().gaussians(posed_frame(run, frame)), run)


def ply_bytes(gaussians: PosedGaussians, run: FittedRun) -> bytes:
    """A whole PLY file of these Gaussians; a comment says the licence of the body."""
    columns = [
        gaussians.means,
        (gaussians.colors - 0.5) / C0,
        gaussians.opacities.clamp(1 - MAX_OPACITY, MAX_OPACITY).double().logit().float()[:, None],
        gaussians.scales.log(),
        gaussians.quats,
    ]
    table = torch.cat(columns, dim=1).numpy().astype("<f4")
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment body: {run.observations.body.licence}", f"element vertex {len(table)}"]
    header += [f"property float {name}" for name in PROPERTIES]
    return ("\n".join([*header, "end_header"]) + "\n").encode() + np.ascontiguousarray(
        table
    ).tobytes()
