"""Registry of trajectories: each kind by the name that it has in `params.yaml` and on disk."""

from typing import Annotated, Any

from pydantic import PlainValidator, SerializeAsAny

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.errors import ArtifactError
from deblur_avatar.motion.clip import ClipMotion
from deblur_avatar.motion.cubic import CubicMotion
from deblur_avatar.motion.frame import FixedMotion, FrameMotion
from deblur_avatar.motion.learned import LearnedMotion
from deblur_avatar.motion.pair import PairMotion
from deblur_avatar.motion.released import ReleasedMotion
from deblur_avatar.motion.trajectory import MotionParams, Trajectory

KINDS: dict[str, type[Trajectory]] = {
    trajectory.kind: trajectory
    for trajectory in (
        FixedMotion,
        FrameMotion,
        PairMotion,
        CubicMotion,
        LearnedMotion,
        ReleasedMotion,
        ClipMotion,
    )
}


def _params_of_kind(section: Any) -> MotionParams:
    """Check a section against the class of its `kind`."""
    if isinstance(section, MotionParams):
        return section
    kind = section.get("kind") if isinstance(section, dict) else None
    if kind not in KINDS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}")
    return KINDS[kind].Params.model_validate(section)


# The section of any kind; a union that is looked up when it is read, so that it is said once.
AnyMotionParams = Annotated[SerializeAsAny[MotionParams], PlainValidator(_params_of_kind)]


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
