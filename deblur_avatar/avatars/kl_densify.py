"""Densification by divergence: Gaussians split or multiply where they differ from the nearest.

Conventions. Canonical space, metres. The nearest of a Gaussian is the one whose centre is; their
divergence is Kullback and Leibler's, of the Gaussian from its nearest. All is decided on one
snapshot of the set, and no Gaussian has a part in two edits.

Source: GauHuman (Hu et al., CVPR 2024), whose edits follow one another on indices of the first.
"""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from deblur_avatar.avatars.gaussian_edits import (
    Edits,
    Part,
    copied,
    drawn_within,
    halves,
    strongest,
)
from deblur_avatar.avatars.gaussians import Gaussians, neighbour_indices
from deblur_avatar.avatars.params import DensifyParams
from deblur_avatar.config.section import Positive
from deblur_avatar.geometry.nearest import nearest
from deblur_avatar.geometry.rotations import quat_to_matrix

# Not a parameter: GauHuman's.
MERGED_SHARE = 0.8  # of the width of a merged Gaussian was its first's


class KlDensifyParams(DensifyParams):
    """Where Gaussians are added, merged and taken away."""

    kl_split: Positive  # nearest of more divergence: clone or split
    kl_merge: Positive  # of less: merge with it
    body_distance_m: Positive  # farther from the nearest vertex none may stand


def kl_edits(
    gaussians: Gaussians,
    pulls: Float[Tensor, " N"],
    params: KlDensifyParams,
    room: int,
    vertices: Float[Tensor, "V 3"],
    generator: torch.Generator,
) -> Edits:
    """Merge pairs that are alike; clone small, split large Gaussians that are not.

    Args:
        gaussians: the set as it is.
        pulls: mean length of each one's screen gradient; those above the threshold are edited.
        params: thresholds.
        room: how many Gaussians may come on top.
        vertices: of the canonical body, which none may leave.
        generator: of the places of new Gaussians.
    """
    nearest, divergence = divergence_from_nearest(gaussians)
    small = gaussians.scales.amax(1) <= params.clone_below_m
    alike = (pulls > params.gradient) & small & (divergence < params.kl_merge)
    pairs = disjoint_pairs(alike.nonzero()[:, 0], nearest, divergence)
    merged = torch.zeros_like(alike)
    merged[pairs.flatten()] = True
    grows = (divergence > params.kl_split) & ~merged
    chosen = strongest(torch.where(grows, pulls, torch.zeros_like(pulls)), params.gradient, room)
    clone, split = chosen & small, chosen & ~small
    added = [
        merge(gaussians, pairs),
        drawn_within(copied(gaussians, clone), generator),
        *halves(gaussians, split, generator),
    ]
    everyone = copied(gaussians, torch.ones_like(alike))
    keep = ~(merged | split) & _may_stay(everyone, params, vertices)
    return keep, [_without_strays(part, params, vertices) for part in added]


def divergence_from_nearest(
    gaussians: Gaussians,
) -> tuple[Int64[Tensor, " N"], Float[Tensor, " N"]]:
    """Who is nearest to each Gaussian, and how far it diverges from that one.

    One that is alone diverges without bound, from itself.
    """
    near = neighbour_indices(gaussians.means, 1)
    if not near.shape[1]:
        alone = gaussians.means.new_full((len(near),), torch.inf)
        return torch.arange(len(near), device=near.device), alone
    nearest = near[:, 0]
    own = gaussians.means, gaussians.quats, gaussians.log_scales
    others = tuple(value[nearest] for value in own)
    return nearest, kl_divergence(*own, *others)


def kl_divergence(
    means: Float[Tensor, "N 3"],
    quats: Float[Tensor, "N 4"],
    log_scales: Float[Tensor, "N 3"],
    other_means: Float[Tensor, "N 3"],
    other_quats: Float[Tensor, "N 4"],
    other_log_scales: Float[Tensor, "N 3"],
) -> Float[Tensor, " N"]:
    """Kullback-Leibler divergence of normal distributions from others.

    In the other's own axes, in units of its widths, its covariance is the identity.
    """
    into = quat_to_matrix(other_quats).mT / other_log_scales.exp()[:, :, None]
    factors = (into @ quat_to_matrix(quats)) * log_scales.exp()[:, None, :]
    apart = (into @ (other_means - means)[..., None])[..., 0]
    spread = factors.square().sum((1, 2)) + apart.square().sum(1)
    return 0.5 * (spread - 3) + (other_log_scales - log_scales).sum(1)


def disjoint_pairs(
    first: Int64[Tensor, " M"], nearest: Int64[Tensor, " N"], divergence: Float[Tensor, " N"]
) -> Int64[Tensor, "pairs 2"]:
    """Pairs of some Gaussians with their nearest, the most alike first, nobody in two of them."""
    taken: set[int] = set()
    pairs: list[tuple[int, int]] = []
    for place in first[divergence[first].argsort(stable=True)].tolist():
        other = int(nearest[place])
        if not {place, other} & taken:
            taken |= {place, other}
            pairs.append((place, other))
    return torch.tensor(pairs, dtype=torch.long, device=first.device).reshape(-1, 2)


def merge(gaussians: Gaussians, pairs: Int64[Tensor, "pairs 2"]) -> Part:
    """One Gaussian of each pair: the first's shape, wider; the mean of all else as it is stored."""
    first, second = (copied(gaussians, side) for side in pairs.T)
    part = {name: (value + second[name]) / 2 for name, value in first.items()}
    part["quats"] = first["quats"]
    part["log_scales"] = (first["log_scales"].exp() / MERGED_SHARE).log()
    return part


def _without_strays(part: Part, params: KlDensifyParams, vertices: Tensor) -> Part:
    stays = _may_stay(part, params, vertices)
    return {name: value[stays] for name, value in part.items()}


def _may_stay(part: Part, params: KlDensifyParams, vertices: Tensor) -> Tensor:
    """Which Gaussians are neither faint, nor huge, nor off the body."""
    near = nearest(part["means"], vertices).distances[:, 0] <= params.body_distance_m
    opaque = part["opacity_logits"].sigmoid() >= params.prune_opacity
    return near & opaque & (part["log_scales"].exp().amax(1) <= params.prune_scale_m)
