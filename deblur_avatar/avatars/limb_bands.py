"""Bands around limbs: colours of a side that is not seen, by those of the side that is.

Sleeves, trousers, shoes and skin go round a limb, and end at a place along it. So what no frame
shows most likely has the colour that is seen at the same place along the same limb. That is a
median, so that a print is no colour of a back, while the hem of a shirt stays where it is. Of the
head, whose front is a face, the scalp is one: hair, a cap or skin, wherever some of it is seen. An
arm or leg that is hidden has the colours of the other one.

Conventions. Canonical pose, metres, +Y up, facing +Z. N Gaussians, J joints, V vertices.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int
from torch import Tensor

from deblur_avatar.artifacts.body import Body

# Joints whose limbs are parts of another joint's.
PART_OF = {
    **dict.fromkeys(("spine1", "spine2", "spine3", "left_collar", "right_collar"), "pelvis"),
    "left_foot": "left_ankle", "right_foot": "right_ankle",
    "left_hand": "left_wrist", "right_hand": "right_wrist",
}  # fmt: skip
UPRIGHT = ("pelvis", "neck", "head")  # limbs along +Y, whatever way to the next joint is
# The hairline of an adult's head, by eye: at its back at a quarter of the height of its box, at the
# front at 0.9 of it, straight between them.
NAPE, BROW = 0.25, 0.9
EARS = 0.5  # of the box's depth: what is farther back is behind them
STEP = 0.01  # metres between places for which a colour is found
ALONG, ALONG_TRUNK = 0.05, 0.08  # metres to either side that tell: the trunk's prints are larger
FEWEST = 8  # Gaussians that tell a colour
HIDDEN = 0.2  # of what the other side's limb tells, below which a limb is hidden


class LimbPlaces(NamedTuple):
    """Where on a body Gaussians are."""

    limbs: Int[np.ndarray, " N"]  # rows of the joints that move them; the scalp is one more
    along: Float[np.ndarray, " N"]  # metres along the limb; 0 all over the scalp
    behind: Bool[np.ndarray, " N"]  # scalp behind the ears
    trunk: int  # its row
    mirrored: tuple[int, ...]  # of each row, that of the limb on the other side, or its own


def limb_places(
    means: Float[Tensor, "N 3"],
    weights: Float[Tensor, "N J"],
    joints: Float[Tensor, "J 3"],
    vertices: Float[Tensor, "V 3"],
    body: Body,
) -> LimbPlaces:
    """Tell on which limb Gaussians are, and how far along it.

    Args:
        means: centres of the Gaussians.
        weights: blend weights there.
        joints: of the body in this pose.
        vertices: of the body in this pose.
        body: whose they are.
    """
    names = list(body.joint_names)
    whole = torch.tensor([names.index(PART_OF.get(name, name)) for name in names])
    limbs = whole[weights.argmax(1)]
    along = ((means - joints[limbs]) * _axes(joints, body)[limbs]).sum(1)
    head = names.index("head")
    corners = vertices[body.lbs_weights.argmax(1) == head]
    low, high = corners.amin(0), corners.amax(0)
    _, height, depth = ((means - low) / (high - low)).unbind(1)
    scalp = (limbs == head) & (height > NAPE + (BROW - NAPE) * depth)
    return LimbPlaces(
        torch.where(scalp, len(names), limbs).numpy(),
        torch.where(scalp, 0.0, along).numpy(),
        (scalp & (depth < EARS)).numpy(),
        names.index("pelvis"),
        (*(names.index(_other_side(name)) for name in names), len(names)),
    )


def band_colors(
    colors: Float64[np.ndarray, "N C"], told: Float[np.ndarray, " N"], places: LimbPlaces
) -> Float64[np.ndarray, "N C"]:
    """Medians of the colours that are known at the same places along limbs.

    Args:
        colors: of which some are known.
        told: by how much each tells, pixels; 0 where it is not known.
        places: where the Gaussians are.

    Returns:
        On a limb that is hidden, against the other side's, those of both; NaN where fewer than
        `FEWEST` Gaussians tell a colour.
    """
    found = np.full(colors.shape, np.nan)
    steps = np.round(places.along / STEP).astype(int)
    for limb in np.unique(places.limbs):
        here = np.flatnonzero(places.limbs == limb)
        known = here[told[here] > 0]
        other = np.flatnonzero((places.limbs == places.mirrored[limb]) & (told > 0))
        if told[known].sum() < HIDDEN * told[other].sum():
            known = np.union1d(known, other)
        if len(known) < FEWEST:
            continue
        for step in np.unique(steps[here]):
            away = np.abs(places.along[known] - step * STEP)
            reach = ALONG_TRUNK if limb == places.trunk else ALONG
            near = known[away <= max(reach, np.partition(away, FEWEST - 1)[FEWEST - 1])]
            found[here[steps[here] == step]] = _median(colors[near], told[near])
    return found


def _other_side(name: str) -> str:
    """The joint on a body's other side; in its middle, the same."""
    side, _, rest = name.partition("_")
    return {"left": f"right_{rest}", "right": f"left_{rest}"}.get(side, name)


def _axes(joints: Float[Tensor, "J 3"], body: Body) -> Float[Tensor, "J 3"]:
    """Unit vectors along limbs: to the joints that follow; 0 of hands and feet, parts of others."""
    axes = torch.zeros_like(joints)
    for row, name in enumerate(body.joint_names):
        next_ones = [child for child, one in enumerate(body.parents) if one == row]
        if name in UPRIGHT:
            axes[row, 1] = 1.0
        elif next_ones:
            axes[row] = joints[next_ones].mean(0) - joints[row]
    return torch.nn.functional.normalize(axes, dim=1)


def _median(
    values: Float64[np.ndarray, "M C"], weights: Float[np.ndarray, " M"]
) -> Float64[np.ndarray, " C"]:
    """Weighted medians, channel by channel."""
    order = values.argsort(0, kind="stable")
    total = weights[order].cumsum(0)
    middle = (total < total[-1] / 2).sum(0)
    return np.take_along_axis(np.take_along_axis(values, order, 0), middle[None], 0)[0]
