"""Spherical-harmonic colours: what colour a Gaussian has from each side.

Conventions. K = (degree + 1)^2 coefficients a channel, the constant one first. A Gaussian's
features are 3 K numbers: its three constants, then the others, harmonic by harmonic. The others are
stored times 20, so that one learning rate moves them a twentieth as far as the constants, as in
3DGS.
Directions are unit vectors from the camera, in whichever frame the colours are to turn with.
"""

from collections.abc import Sequence
from typing import Annotated, Any

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.networks import spherical_harmonics
from deblur_avatar.avatars.params import Iteration, SplatFitting

# Not parameters: 3DGS's (Kerbl et al. 2023).
CONSTANT = 0.28209479177388  # the harmonic of degree 0
GREY = 0.5  # the colour of features that are all zero
STORED_SHARE = 1 / 20  # what a stored coefficient of degree 1 and up counts
CHANNELS = 3

Degree = Annotated[int, Field(ge=0, le=3)]


class HarmonicFitting(SplatFitting):
    """How Gaussians are fitted whose colours are harmonics: at first of degree 0."""

    harmonics_up_at: tuple[Iteration, ...]  # after each another degree counts

    def check(self, model: Any) -> None:
        """Refuse degrees of the model's `harmonics` that never count, or that there are not."""
        if len(self.harmonics_up_at) != model.harmonics:
            raise ValueError(
                f"harmonics_up_at must name {model.harmonics} iterations, one a degree of the "
                f"model's harmonics, got {len(self.harmonics_up_at)}"
            )


def harmonic_features(degree: int) -> int:
    """How many features a Gaussian has with harmonics up to a degree."""
    return CHANNELS * (degree + 1) ** 2


def constant_coefficients(features: Float[Tensor, "N D"]) -> Float[Tensor, "N 3"]:
    """Coefficients of degree 0."""
    return features[:, :CHANNELS]


def further_coefficients(features: Float[Tensor, "N D"]) -> Float[Tensor, "N C"]:
    """Coefficients of degree 1 and up, harmonic by harmonic."""
    return STORED_SHARE * features[:, CHANNELS:]


def harmonic_colors(
    features: Float[Tensor, "N D"], directions: Float[Tensor, "N 3"], degree: int
) -> Float[Tensor, "N 3"]:
    """Colours, at least 0 and not bounded above.

    Args:
        features: of each Gaussian.
        directions: in which each is seen.
        degree: up to which harmonics count; 0 for one colour from all sides.

    Raises:
        ValueError: if there are no features of that degree, or no harmonics (3 is the highest).
    """
    wanted = harmonic_features(degree)
    if not 0 <= degree <= 3 or features.shape[1] < wanted:
        raise ValueError(
            f"harmonics of degree {degree} take {wanted} features and degree 3 is the highest, "
            f"got {features.shape[1]} features"
        )
    colors = GREY + CONSTANT * constant_coefficients(features)
    if degree > 0:
        harmonics = spherical_harmonics(directions)[:, : (degree + 1) ** 2 - 1]
        further = further_coefficients(features[:, :wanted]).unflatten(1, (-1, CHANNELS))
        colors = colors + (harmonics[..., None] * further).sum(1)
    return colors.clamp(min=0)


def degree_at(step: TrainingStep | None, degree: int, up_at: Sequence[int]) -> int:
    """The degree of an avatar that is fitted: one more after each of some iterations.

    Args:
        step: of fitting; None for an avatar as it is, at its full degree.
        degree: the highest.
        up_at: the paper's iterations after which another degree counts, one a degree.
    """
    return degree if step is None else sum(step.past(iteration) for iteration in up_at)


def seen_from(
    frames: Float[Tensor, "N 3 3"], points: Float[Tensor, "N 3"], camera_centre: Float[Tensor, " 3"]
) -> Float[Tensor, "N 3"]:
    """Directions in which points are seen, each in a frame of its own.

    Args:
        frames: of each point, columns in world coordinates; need not be orthonormal.
        points: world positions, metres.
        camera_centre: world position, metres.
    """
    turned = (frames.mT @ (points - camera_centre)[..., None])[..., 0]
    return torch.nn.functional.normalize(turned, dim=-1)
