"""Pose track smoothness: jumps are steps much faster than those before and after."""

from typing import Any

from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed

SLOW = 0.25  # m/s; below it a joint stands, and no step is a jump by being a multiple of nothing


def measure_track(body: Body, poses: Poses, timestamps: Float[Tensor, " F"]) -> dict[str, Any]:
    """Compare each joint's speed over each step with the mean of the steps around it.

    Returns:
        `speed_ratio`: the largest ratio, with its `joint` and `step` (from that frame to the
        next), and the largest of each joint in `by_joint`; `fastest_m_s`: the highest speed.
        Empty for fewer than four frames.
    """
    joints = posed(body, poses).joints
    if len(joints) < 4:
        return {}
    speeds = (joints[1:] - joints[:-1]).norm(dim=-1) / timestamps.diff()[:, None]
    around = (speeds[:-2] + speeds[2:]) / 2
    ratios = speeds[1:-1] / around.clamp(min=SLOW)
    worst = int(ratios.argmax())
    step, joint = divmod(worst, ratios.shape[1])
    return {
        "speed_ratio": float(ratios.max()),
        "joint": body.joint_names[joint],
        "step": step + 1,
        "fastest_m_s": float(speeds.max()),
        "by_joint": dict(zip(body.joint_names, ratios.amax(0).tolist(), strict=True)),
    }
