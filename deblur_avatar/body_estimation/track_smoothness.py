"""Pose track smoothness: jumps are steps much faster than those before and after."""

from typing import Any

from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed

SLOW = 0.25  # m/s; below it a joint stands, and no step is a jump by being a multiple of nothing


def measure_track(
    body: Body, poses: Poses, timestamps: Float[Tensor, " F"], seen: Bool[Tensor, " F"]
) -> dict[str, Any]:
    """Compare each joint's speed over each step with the mean of the steps around it.

    Args:
        body: whose poses these are.
        poses: of consecutive frames.
        timestamps: seconds.
        seen: the frames whose pose rests on what was seen: of steps to or from others, or beside
            such, nothing is said.

    Returns:
        `speed_ratio`: the largest ratio, with its `joint` and `step` (from that frame to the
        next), and the largest of each joint in `by_joint`; `fastest_m_s`: the highest speed.
        Empty where nobody is seen in four frames in a row.
    """
    between = seen[1:] & seen[:-1]
    compared = between[:-2] & between[1:-1] & between[2:]
    if not bool(compared.any()):
        return {}
    joints = posed(body, poses).joints
    speeds = (joints[1:] - joints[:-1]).norm(dim=-1) / timestamps.diff()[:, None]
    around = (speeds[:-2] + speeds[2:]) / 2
    ratios = speeds[1:-1] / around.clamp(min=SLOW) * compared[:, None]
    worst = int(ratios.argmax())
    step, joint = divmod(worst, ratios.shape[1])
    return {
        "speed_ratio": float(ratios.max()),
        "joint": body.joint_names[joint],
        "step": step + 1,
        "fastest_m_s": float(speeds[between].max()),
        "by_joint": dict(zip(body.joint_names, ratios.amax(0).tolist(), strict=True)),
    }
