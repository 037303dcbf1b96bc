"""Plain avatars whose unseen Gaussians take their colours from the seen ones around them.

Of a person who does not turn, the camera shows one side. Likeness of neighbours (`plain_avatar.py`)
carries colours to the other only as far as a fit has steps for: its penalty is absolute, so that a
patch which nothing has coloured moves at its edge alone, and what is far from that keeps the grey
it began with. Once the avatar is fitted, the same penalty is brought to its minimum over Gaussians
whose light no frame shows: total variation inpainting (Chan and Shen, "Nontexture inpainting by
curvature-driven diffusions", JVCIR 2001) on the graph of nearest neighbours, by reweighted least
squares (Daubechies et al., CPAM 2010). It ends where a shirt ends, which a mean would not.
"""

from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64
from scipy.sparse import csr_matrix, diags_array
from scipy.sparse.linalg import splu
from torch import Tensor

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.gaussians import neighbour_indices
from deblur_avatar.avatars.params import AvatarParams, FittingParams
from deblur_avatar.avatars.plain_avatar import COLORS, PlainAvatar, PlainFitting
from deblur_avatar.config.section import Positive
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.geometry.rotations import axis_angle_to_matrix

LOOKS = 48  # frames at most, spread over the clip
NEIGHBOURS = 8
FAR = 1e-4  # weight of a neighbour however far it is, so that no Gaussian is alone
OWN = 1e-9  # of a Gaussian's own colour, where all that it is connected with is unseen
ROUNDS = 12  # of reweighting; the first one's colours are harmonic
ALIKE = 0.01  # colours this near to each other count as one
DARKEST = 1e-3  # colours stay this far from black and white, whose logits are infinite


class InpaintedParams(AvatarParams):
    """Nothing to choose."""

    kind: Literal["inpainted"]


class InpaintedFitting(PlainFitting):
    """As a plain one; a Gaussian that shows fewer pixels than that in every frame is unseen."""

    least_pixels: Positive


class InpaintedAvatar(PlainAvatar):
    """A plain avatar whose colours go on where no frame shows any."""

    kind = "inpainted"
    Params: ClassVar[type[AvatarParams]] = InpaintedParams
    Fitting: ClassVar[type[FittingParams]] = InpaintedFitting

    def inpaint(self, fitting: InpaintedFitting, poses: Poses, camera: Camera) -> None:
        """Fill in the colours of Gaussians that show too little of themselves in every frame."""
        known = (self.most_pixels(poses, camera) >= fitting.least_pixels).cpu().numpy()
        if known.all() or not known.any():
            return
        features = self.gaussians.features
        colors = features[:, :COLORS].detach().sigmoid().cpu().double().numpy()
        means = self.gaussians.means.detach().cpu().double().numpy()
        filled = torch.from_numpy(inpainted(means, colors, known)[~known])
        logits = filled.clamp(DARKEST, 1 - DARKEST).logit().to(features)
        with torch.no_grad():
            features[torch.from_numpy(~known).to(features.device), :COLORS] = logits

    def most_pixels(self, poses: Poses, camera: Camera) -> Float[Tensor, " N"]:
        """How many pixels' worth of light each Gaussian sends to the camera, in the frame of most.

        Args:
            poses: one a frame; at most `LOOKS` of them are rendered.
            camera: that films.
        """
        device, count = self.betas.device, len(poses.transl)
        camera = camera.to(device)
        chosen = np.linspace(0, count - 1, min(LOOKS, count)).round().astype(int)
        some = poses.at(chosen.tolist())
        rotations = axis_angle_to_matrix(some.axis_angle)
        most = torch.zeros(len(self.gaussians), device=device)
        for turned, transl in zip(rotations, some.transl, strict=True):
            with torch.no_grad():
                transforms = self.transforms(turned[None], transl[None])
                state = self.condition(turned.to(device), 0, transforms[0], camera.viewmat)
            # Its colour's share of the picture's sum is what a Gaussian shows.
            white = torch.ones_like(state.colors, requires_grad=True)
            rendering = self.render(replace(state, colors=white), transforms, camera)
            (pixels,) = torch.autograd.grad(rendering.image.sum(), white)
            most = torch.maximum(most, pixels[:, 0])
        return most


def inpainted(
    points: Float64[np.ndarray, "N 3"],
    values: Float64[np.ndarray, "N D"],
    known: Bool[np.ndarray, " N"],
) -> Float64[np.ndarray, "N D"]:
    """Values that are known, and between them those of least total variation over neighbours.

    What no known point is connected with becomes its own mean.

    Args:
        points: metres.
        values: those of unknown points hardly count.
        known: which values stay.
    """
    links = neighbour_weights(points)
    unknown, outer = np.flatnonzero(~known), np.flatnonzero(known)
    rows = links[unknown].tocoo()
    here, there = unknown[rows.row], rows.col
    filled = values.copy()
    for turn in range(ROUNDS):
        apart = np.linalg.norm(filled[here] - filled[there], axis=1).clip(ALIKE) if turn else 1.0
        weights = csr_matrix((rows.data / apart, (rows.row, there)), shape=rows.shape)
        total = np.asarray(weights.sum(1)).ravel() + OWN
        inner = diags_array(total) - weights[:, unknown]
        given = weights[:, outer] @ values[outer] + OWN * values[unknown]
        filled[unknown] = splu(inner.tocsc()).solve(given)
    return filled


def neighbour_weights(points: Float64[np.ndarray, "N 3"]) -> csr_matrix:
    """Symmetric weights [N,N] of nearest neighbours, nearer ones weighing more."""
    indices = neighbour_indices(torch.from_numpy(points), NEIGHBOURS).numpy()
    distances = np.linalg.norm(points[indices] - points[:, None], axis=-1)
    weights = FAR + np.exp(-((distances / np.median(distances)) ** 2))
    rows = np.repeat(np.arange(len(points)), indices.shape[1])
    links = csr_matrix((weights.ravel(), (rows, indices.ravel())), shape=(len(points),) * 2)
    return links.maximum(links.T)
