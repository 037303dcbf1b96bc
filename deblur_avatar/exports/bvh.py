"""Biovision hierarchy (`.bvh`): the skeleton and one motion, for programs that animate people.

Conventions. Centimetres; the person upright (`upright.py`). Offsets are those of the rest pose
(T-pose), joints come depth first, as channels must; each has Z, Y, X rotations in degrees, the
first outermost, the root its position before them. Leaves end where they are.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.config.section import Params, Positive
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.shown_motion import even_motion
from deblur_avatar.exports.upright import rest_pelvis, upright_of
from deblur_avatar.files import write_text

CENTIMETRES = 100.0
TIP = 5.0  # centimetres from a last joint to its end, which readers want and nothing tells
ROTATIONS = "Zrotation Yrotation Xrotation"


class BvhExport(Params):
    """One motion of the fitted skeleton."""

    suffix: ClassVar[str] = ".bvh"

    format: Literal["bvh"]
    motion: str  # own, builtin:<name> or a file
    fps: Positive  # of a motion that was not filmed
    seconds: Positive  # longest duration of it

    def export(self, run: FittedRun, path: Path) -> None:
        """Write the motion at an even rate."""
        body = run.observations.body
        motion, rate = even_motion(run, self.motion, self.fps, self.seconds)
        quats, places = upright_of(run).pose(motion.poses, rest_pelvis(run))
        turned = Rotation.from_quat(quats.flatten(0, 1).double().numpy(), scalar_first=True)
        angles = turned.as_euler("ZYX", degrees=True).reshape(*quats.shape[:2], 3)
        joints = shaped_joints(body, run.avatar.betas).double().numpy() * CENTIMETRES
        order = depth_first(body.parents)
        lines = ["HIERARCHY", *_hierarchy(joints, body.parents, body.joint_names), "MOTION"]
        lines += [f"Frames: {len(angles)}", f"Frame Time: {1 / rate:.8f}"]
        rows = np.concatenate(
            [places.double().numpy() * CENTIMETRES, angles[:, order].reshape(len(angles), -1)], 1
        )
        lines += [" ".join(f"{value:.6f}" for value in row) for row in rows]
        write_text(path, "\n".join(lines) + "\n")


def depth_first(parents: Sequence[int], joint: int = 0) -> list[int]:
    """Joints in the order in which a hierarchy names them."""
    children = [child for child, parent in enumerate(parents) if parent == joint]
    return [joint, *(below for child in children for below in depth_first(parents, child))]


def _hierarchy(
    joints: Float[np.ndarray, "J 3"], parents: Sequence[int], names: Sequence[str], joint: int = 0
) -> list[str]:
    """The lines of a joint and of all below it."""
    root = parents[joint] < 0
    offset = joints[joint] - (0 if root else joints[parents[joint]])
    channels = f"6 Xposition Yposition Zposition {ROTATIONS}" if root else f"3 {ROTATIONS}"
    children = [child for child, parent in enumerate(parents) if parent == joint]
    inner = [line for child in children for line in _hierarchy(joints, parents, names, child)]
    if not children:
        tip = offset / max(float(np.linalg.norm(offset)), 1e-9) * TIP
        inner = ["End Site", "{", f"  OFFSET {_numbers(tip)}", "}"]
    return [
        f"{'ROOT' if root else 'JOINT'} {names[joint]}",
        "{",
        f"  OFFSET {_numbers(np.zeros(3) if root else offset)}",
        f"  CHANNELS {channels}",
        *(f"  {line}" for line in inner),
        "}",
    ]


def _numbers(values: Float[np.ndarray, " 3"]) -> str:
    return " ".join(f"{value:.6f}" for value in values)
