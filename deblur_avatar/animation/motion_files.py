"""A motion by its name in the parameters: built in, or a file of one of three formats."""

import logging
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from deblur_avatar.animation.aist import read_aist
from deblur_avatar.animation.amass import read_amass
from deblur_avatar.animation.builtin_motions import builtin_motion
from deblur_avatar.animation.bvh import read_bvh
from deblur_avatar.animation.driving_motion import BodyMotion, resample
from deblur_avatar.animation.retargeting import moving_bones, retarget
from deblur_avatar.artifacts.body import Body
from deblur_avatar.errors import ArtifactError, ConfigError

logger = logging.getLogger(__name__)

BUILTIN = "builtin:"


def read_motion(
    name: str,
    body: Body,
    betas: Float[Tensor, " B"],
    *,
    fps: float,
    start: float,
    seconds: float,
) -> BodyMotion:
    """Read or make `seconds` of a motion from `start` on, for one person, at `fps`.

    Args:
        name: `builtin:<name>`, or the path of a `.bvh`, of an AMASS `.npz` or of an AIST++ `.pkl`.
        body: whose motion it becomes; skeletons are retargeted to its proportions.
        betas: the shape of that person.
        fps: frames a second of the result.
        start: seconds into the motion.
        seconds: how long; a motion that ends earlier gives fewer frames.

    Raises:
        ConfigError: if there is no such motion, or it ends before `start`.
        ArtifactError: if the file is damaged; names it, and the line where it has lines.
    """
    if name.startswith(BUILTIN):
        return builtin_motion(name.removeprefix(BUILTIN), fps, start, seconds)
    path = Path(name)
    if not path.is_file():
        raise ConfigError(
            f"no motion file {path}; set animate.motion to a .bvh, an AMASS .npz, an AIST++ .pkl "
            "or builtin:jumping_jacks"
        )
    motion = _read(path, body, betas)
    try:
        return resample(motion, fps, start, seconds)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def _read(path: Path, body: Body, betas: Float[Tensor, " B"]) -> BodyMotion:
    match path.suffix.lower():
        case ".bvh":
            try:
                skeleton = read_bvh(path)
                motion, moving = retarget(skeleton, body, betas), moving_bones(skeleton)
            except ArtifactError as error:
                prefix = "" if str(path) in str(error) else f"{path}: "
                raise ArtifactError(f"{prefix}{error}") from None
            if moving:
                logger.warning(
                    "%s: positions of %s change, which is not read: below the hips bones are "
                    "rigid, and only turn",
                    path,
                    ", ".join(moving),
                )
            return motion
        case ".npz":
            return read_amass(path)
        case ".pkl":
            return read_aist(path)
        case other:
            raise ConfigError(f"{path}: a motion is a .bvh, .npz or .pkl file, got {other!r}")
