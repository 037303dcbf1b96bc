"""Rig mapping: which joint of a named skeleton is which of SMPL's.

Names are compared without case, punctuation and anything up to a colon (`mixamorig:LeftArm`); a
side may stand at the end, apart (`UpperLeg_L`). Only the ends of limbs need names; spine,
neck and collar bones are what lies between them in the tree.
"""

import re
from collections.abc import Sequence

from deblur_avatar.errors import ArtifactError

# In the order of preference: "LeftShoulder" is an upper arm only where nothing else is.
_LIMBS = {
    "hip": ("upleg", "hip", "thigh", "upperleg"),
    "knee": ("leg", "knee", "shin", "lowerleg", "lowleg", "calf"),
    "ankle": ("foot", "ankle"),
    "shoulder": ("arm", "upperarm", "uparm", "shoulder"),
    "elbow": ("forearm", "elbow", "lowerarm", "lowarm"),
    "wrist": ("hand", "wrist"),
}
# By SMPL's name, without case and punctuation.
NAMES = {
    "pelvis": ("hips", "pelvis", "hip", "root"),
    "head": ("head",),
    **{
        f"{side}_{joint}": tuple(
            form for word in words for form in (f"{side}{word}", f"{side[0]}{word}")
        )
        for side in ("left", "right")
        for joint, words in _LIMBS.items()
    },
}


def recognise(names: Sequence[str], parents: Sequence[int]) -> dict[str, int]:
    """Find SMPL's joints by name and by place in the tree.

    Returns:
        Index of each joint found, by SMPL's name. Always there: pelvis, hips, knees, ankles,
        spine3, head, shoulders, elbows, wrists. Where the tree has them: spine1, spine2, neck,
        collars.

    Raises:
        ArtifactError: if a joint of the first kind is missing, or arms and head do not hang on one
            chest above the pelvis.
    """
    plain = [_plain(name) for name in names]
    found = {}
    for joint, forms in NAMES.items():
        index = next((plain.index(form) for form in forms if form in plain), None)
        if index is not None:
            found[joint] = index
    missing = [joint for joint in NAMES if joint not in found]
    if missing:
        raise ArtifactError(
            f"the skeleton has no joint for {', '.join(missing)}; it has {', '.join(names)}. "
            "Names as mixamo's, CMU's or Bandai Namco's are understood"
        )
    ways = {joint: _way_down(found[joint], found["pelvis"], parents) for joint in found}
    for joint, way in ways.items():
        if way is None:
            raise ArtifactError(f"{names[found[joint]]} does not hang on {names[found['pelvis']]}")
    return {**found, **_between(found, {joint: way or [] for joint, way in ways.items()})}


def _plain(name: str) -> str:
    """A name to be compared, its side first."""
    own = name.rsplit(":", 1)[-1].lower()
    side_last = re.fullmatch(r"(.+)[^a-z0-9](left|right|l|r)", own)
    ordered = own if side_last is None else side_last[2] + side_last[1]
    return re.sub(r"[^a-z0-9]", "", ordered)


def _way_down(joint: int, pelvis: int, parents: Sequence[int]) -> list[int] | None:
    """Joints from below the pelvis to this one, both ends but the pelvis included."""
    way = []
    while joint != pelvis:
        if joint < 0:
            return None
        way.append(joint)
        joint = parents[joint]
    return way[::-1]


def _between(found: dict[str, int], ways: dict[str, list[int]]) -> dict[str, int]:
    shared = [
        joint
        for joint in ways["left_shoulder"]
        if joint in ways["right_shoulder"] and joint in ways["head"]
    ]
    if not shared:
        raise ArtifactError("arms and head must hang on one chest above the pelvis")
    chest = shared[-1]
    between = {"spine3": chest}
    below = shared[:-1]
    if below:
        between["spine1"] = below[0]
    if len(below) > 1:
        between["spine2"] = below[len(below) // 2]
    neck = ways["head"][len(shared) : -1]
    if neck:
        between["neck"] = neck[0]
    for side in ("left", "right"):
        collar = ways[f"{side}_shoulder"][len(shared) : -1]
        if collar:
            between[f"{side}_collar"] = collar[-1]
    return between
