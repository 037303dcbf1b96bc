"""USD: a motion as Gaussians at every frame (UsdVol's particle field), for renderers of film.

Conventions. USD's: +Y up, metres, one time code a frame; the person upright (`upright.py`). USD
skins no splats, so every frame holds posed ones. Colours are spherical harmonics of degree 0 of
sRGB values; which space readers expect is not settled.

The only module that knows pxr (extra `usd`).
"""

import tempfile
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from deblur_avatar.config.section import Params, Positive
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.ply import C0
from deblur_avatar.exports.posed_gaussians import PosedGaussians, posed_motion
from deblur_avatar.exports.shown_motion import even_motion
from deblur_avatar.exports.upright import upright_of
from deblur_avatar.files import write_bytes

REACH = 3.0  # standard deviations of a Gaussian that the extent holds


class UsdExport(Params):
    """A motion of posed Gaussians, at an even rate."""

    suffix: ClassVar[str] = ".usdc"

    format: Literal["usd"]
    motion: str  # own, builtin:<name> or a file
    fps: Positive  # of a motion that was not filmed
    seconds: Positive  # longest duration of it

    def export(self, run: FittedRun, path: Path) -> None:
        """Write one file with a time sample a frame."""
        try:
            from pxr import Sdf, Usd, UsdGeom, UsdVol
        except ImportError:
            raise ConfigError(
                "export: usd needs usd-core; pip install 'deblur-avatar[usd]'"
            ) from None
        motion, rate = even_motion(run, self.motion, self.fps, self.seconds)
        axes = upright_of(run)
        layer = Sdf.Layer.CreateAnonymous(".usdc")
        scene = Usd.Stage.Open(layer)
        UsdGeom.SetStageUpAxis(scene, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(scene, 1.0)
        scene.SetTimeCodesPerSecond(rate)
        scene.SetStartTimeCode(0)
        scene.SetEndTimeCode(len(motion.times) - 1)
        scene.SetDefaultPrim(UsdGeom.Xform.Define(scene, "/Avatar").GetPrim())
        layer.comment = f"{run.name}. Body: {run.observations.body.licence}"
        splats = UsdVol.ParticleField3DGaussianSplat.Define(scene, "/Avatar/Splats")
        for index, gaussians in enumerate(posed_motion(run, motion.poses)):
            _sample(splats, axes.gaussians(gaussians), index)
        write_bytes(path, _written(layer, path))


def _sample(splats: Any, gaussians: PosedGaussians, index: int) -> None:
    """Set what moves at one frame, and at the first one what does not."""
    from pxr import UsdGeom, Vt

    means, scales = gaussians.means.numpy(), gaussians.scales.numpy()
    xyzw = np.ascontiguousarray(gaussians.quats.numpy()[:, [1, 2, 3, 0]])
    splats.GetPositionsAttr().Set(Vt.Vec3fArray.FromNumpy(means), index)
    splats.GetOrientationsAttr().Set(Vt.QuatfArray.FromNumpy(xyzw), index)
    splats.GetScalesAttr().Set(Vt.Vec3fArray.FromNumpy(scales), index)
    reach = REACH * scales.max(1, keepdims=True)
    box = np.stack([(means - reach).min(0), (means + reach).max(0)]).astype(np.float32)
    splats.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(box), index)
    if index > 0:
        return
    splats.GetOpacitiesAttr().Set(Vt.FloatArray.FromNumpy(gaussians.opacities.numpy()))
    harmonics = (gaussians.colors.numpy() - 0.5) / np.float32(C0)
    splats.CreateRadianceSphericalHarmonicsDegreeAttr().Set(0)
    colors = splats.CreateRadianceSphericalHarmonicsCoefficientsAttr()
    colors.Set(Vt.Vec3fArray.FromNumpy(harmonics))
    colors.SetMetadata("elementSize", 1)
    colors.SetMetadata("interpolation", UsdGeom.Tokens.vertex)


def _written(layer: Any, path: Path) -> bytes:
    """The layer as the bytes of a file; USD writes to a disk only."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / path.name
        layer.Export(str(file))
        return file.read_bytes()
