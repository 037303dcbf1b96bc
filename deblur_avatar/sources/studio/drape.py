"""Cloth offsets from skinning, as smooth functions of the pose.

Conventions. Rest pose, metres. Two effects, both along the rest normal: loose cloth sags to where
down is, and folds rise where a joint bends. It never sinks below its slack. J joints, P vertices.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.sources.studio.clothes import Clothed

SAG = 0.05  # metres that the loosest hem moves when down turns from along it to across it
FOLD = 0.022  # metres, the height of a fold at a joint that is bent by half a turn
FOLD_LENGTH = 0.055  # metres from one fold to the next
FOLD_REACH = 0.13  # metres around the joint
CLEARANCE = 0.002  # metres over which cloth comes softly to rest on what is below
DOWN = np.array([0.0, -1.0, 0.0], np.float32)

# Joints whose bending folds cloth, and the direction in which folds follow one another.
_BENDS = {
    "left_shoulder": (1.0, 0.3, 0.0), "right_shoulder": (-1.0, 0.3, 0.0),
    "left_hip": (0.2, 1.0, 0.3), "right_hip": (-0.2, 1.0, 0.3),
    "left_knee": (0.0, 1.0, 0.2), "right_knee": (0.0, 1.0, -0.2),
    "spine1": (0.3, 1.0, 0.0), "spine2": (-0.3, 1.0, 0.2),
}  # fmt: skip


@dataclass(frozen=True)
class Drape:
    """A clothed person's cloth: what `skinned` needs again and again."""

    vertices: Float32[np.ndarray, "P 3"]
    normals: Float32[np.ndarray, "P 3"]
    lbs_weights: Float32[np.ndarray, "P J"]
    sag: Float32[np.ndarray, " P"]
    slack: Float32[np.ndarray, " P"]
    folds: Float32[np.ndarray, "P K"]  # pattern around each joint of `_BENDS`

    def skinned(
        self,
        joint_transforms: Float32[np.ndarray, "J 4 4"],
        bends: Float32[np.ndarray, " J"],
        swing: Float32[np.ndarray, "J 3"] | None = None,
    ) -> Float32[np.ndarray, "P 3"]:
        """Vertices of the posed person.

        Args:
            joint_transforms: rest to posed.
            bends: how far each joint is turned against its parent, as sin^2 of half the angle.
            swing: added to the pull of gravity on cloth around each joint, in units of that pull.
        """
        world_from_rest = joint_transforms[:, :3, :3]
        down = world_from_rest.transpose(0, 2, 1) @ DOWN - DOWN
        if swing is not None:
            down = down + np.einsum("jki,jk->ji", world_from_rest, swing)
        sag = self.sag * ((self.lbs_weights @ down) * self.normals).sum(1)
        chosen = [SMPL_JOINT_NAMES.index(name) for name in _BENDS]
        lift = sag + self.folds @ bends[chosen]
        room = (lift + self.slack) / CLEARANCE
        lift = CLEARANCE * np.logaddexp(room, 0) - self.slack
        points = self.vertices + np.where(self.slack > 0, lift, 0)[:, None] * self.normals
        transforms = (self.lbs_weights @ joint_transforms[:, :3].reshape(-1, 12)).reshape(-1, 3, 4)
        return np.einsum("pij,pj->pi", transforms[..., :3], points) + transforms[..., 3]


def hang(clothed: Clothed) -> Drape:
    """Prepare the cloth of a clothed person; what has no slack never moves."""
    surface, folds = clothed.surface, []
    for name, direction in _BENDS.items():
        away = surface.vertices - clothed.landmarks.of(name)
        aim = np.asarray(direction) / np.linalg.norm(direction)
        near = np.exp(-0.5 * (away**2).sum(1) / FOLD_REACH**2)
        # Bent by a second wave, so that folds are no straight ridges.
        phase = away @ aim / FOLD_LENGTH + 0.15 * np.sin(away @ np.roll(aim, 1) / 0.04)
        folds.append(FOLD * near * np.sin(2 * np.pi * phase))
    return Drape(
        vertices=surface.vertices.astype(np.float32),
        normals=surface.normals.astype(np.float32),
        lbs_weights=surface.lbs_weights.astype(np.float32),
        sag=(SAG * surface.looseness).astype(np.float32),
        slack=surface.slack.astype(np.float32),
        folds=np.stack(folds, 1).astype(np.float32),
    )
