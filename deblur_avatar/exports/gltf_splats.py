"""KHR_gaussian_splatting: one pose of an avatar as splats in a glTF file.

Conventions. glTF's, the person upright (`upright.py`). Scales and opacities are as they are drawn,
not logarithms or logits; colours are spherical harmonics of degree 0 in the space that the
extension calls the display's sRGB. Programs without the extension see coloured points.

Source: Khronos Group, "KHR_gaussian_splatting", 2026.
"""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from deblur_avatar.config.section import Params
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.gltf_file import VERTICES, GltfFile
from deblur_avatar.exports.ply import C0
from deblur_avatar.exports.posed_gaussians import posed_frame
from deblur_avatar.exports.upright import upright_of
from deblur_avatar.files import write_bytes
from deblur_avatar.imaging.color import srgb_to_linear

EXTENSION = "KHR_gaussian_splatting"


class GltfSplatsExport(Params):
    """One frame's pose, in the colours that the training camera sees."""

    suffix: ClassVar[str] = ".glb"

    format: Literal["gltf_splats"]
    frame: Annotated[int, Field(ge=0)]  # position in the clip

    def export(self, run: FittedRun, path: Path) -> None:
        """Write the avatar at the middle of this frame's exposure."""
        splats = upright_of(run).gaussians(posed_frame(run, self.frame))
        file = GltfFile(run.observations.body.licence)
        light = srgb_to_linear(splats.colors).numpy()
        opacities = splats.opacities.numpy()
        columns = {
            "POSITION": splats.means.numpy(),
            "COLOR_0": np.concatenate([light, opacities[:, None]], 1),
            f"{EXTENSION}:ROTATION": splats.quats.numpy()[:, [1, 2, 3, 0]],
            f"{EXTENSION}:SCALE": splats.scales.numpy(),
            f"{EXTENSION}:OPACITY": opacities,
            f"{EXTENSION}:SH_DEGREE_0_COEF_0": (splats.colors.numpy() - 0.5) / np.float32(C0),
        }
        attributes = {
            name: file.accessor(values, target=VERTICES, bounds=name == "POSITION")
            for name, values in columns.items()
        }
        said = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
        splat = {"attributes": attributes, "mode": 0, "extensions": {EXTENSION: said}}
        file.document |= {
            "extensionsUsed": [EXTENSION],
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": run.name, "mesh": 0}],
            "meshes": [{"name": run.name, "primitives": [splat]}],
        }
        write_bytes(path, file.content())
