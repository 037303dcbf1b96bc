"""Nearest neighbours: which of many points are nearest to each of others."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Float64, Int64
from scipy.spatial import cKDTree
from torch import Tensor

from deblur_avatar.ending import uninterrupted


class Nearest(NamedTuple):
    """Neighbours of P points, the nearest first, on the points' device."""

    distances: Float64[Tensor, "P K"]  # in the points' unit
    indices: Int64[Tensor, "P K"]


def nearest(points: Float[Tensor, "P D"], among: Float[Tensor, "N D"], count: int = 1) -> Nearest:
    """Find the `count` nearest of some points, or all of them where there are fewer.

    By a k-d tree, on all cores. SciPy waits for its threads, and at Ctrl-C frees what they still
    read: the process crashes. So Ctrl-C has to wait, for milliseconds.

    Args:
        points: whose neighbours are wanted; no gradient goes through.
        among: at least one.
        count: K, at least 1.
    """
    wanted = [*range(1, min(count, len(among)) + 1)]
    tree = cKDTree(among.detach().cpu().double().numpy())
    with uninterrupted():
        distances, indices = tree.query(
            points.detach().cpu().double().numpy(), k=wanted, workers=-1
        )
    return Nearest(
        torch.as_tensor(distances, device=points.device),
        torch.as_tensor(indices, device=points.device),
    )
