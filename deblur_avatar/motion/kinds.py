"""Registry of trajectories: each kind by the name that it has in `params.yaml` and on disk."""

from typing import Annotated

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.config.kinds import KindOf, Registry
from deblur_avatar.errors import ArtifactError
from deblur_avatar.motion.trajectory import MotionParams, Trajectory

KINDS: Registry[Trajectory] = Registry(
    {
        "fixed": "deblur_avatar.motion.frame:FixedMotion",
        "frame": "deblur_avatar.motion.frame:FrameMotion",
        "pair": "deblur_avatar.motion.pair:PairMotion",
        "cubic": "deblur_avatar.motion.cubic:CubicMotion",
        "learned": "deblur_avatar.motion.learned:LearnedMotion",
        "released": "deblur_avatar.motion.released:ReleasedMotion",
        "clip": "deblur_avatar.motion.clip:ClipMotion",
        "mad": "deblur_avatar.motion.mad:MadMotion",
        "network": "deblur_avatar.motion.pose_network:NetworkMotion",
    }
)


# The section of any kind.
AnyMotionParams = Annotated[MotionParams, KindOf("kind", KINDS)]


def kind_of(motion: Motion) -> type[Trajectory]:
    """The class of the trajectory that a motion was saved from.

    Raises:
        ArtifactError: if it is of a kind that this version does not know.
    """
    if motion.kind not in KINDS:
        raise ArtifactError(f"no motion of kind {motion.kind!r} is known; run `dvc repro`")
    return KINDS[motion.kind]


def trajectory_from_artifact(motion: Motion) -> Trajectory:
    """Rebuild the trajectory that a stage saved, so that a later stage can go on with it.

    Raises:
        ArtifactError: if it is of a kind that this version does not know.
    """
    return kind_of(motion).from_artifact(motion)
