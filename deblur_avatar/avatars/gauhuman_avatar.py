"""GauHuman's avatar: Gaussians with the nearest vertex's weights, which a network re-weighs.

Conventions. Colours are harmonics that turn with the skin. The release's second network, which
corrects the pose, is a motion here (`motion: {kind: network}`). World coordinates, metres.
"""

from typing import Any, ClassVar, Literal

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from deblur_avatar.artifacts.avatar import part_on_disk
from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.avatar import ParameterGroups, TrainingStep
from deblur_avatar.avatars.gaussian_edits import Edits
from deblur_avatar.avatars.gaussians import Gaussians
from deblur_avatar.avatars.harmonic_colors import (
    Degree,
    HarmonicFitting,
    degree_at,
    harmonic_colors,
    harmonic_features,
    seen_from,
)
from deblur_avatar.avatars.kl_densify import KlDensifyParams, kl_edits
from deblur_avatar.avatars.params import AvatarParams, FittingParams, LearningRate, Precision
from deblur_avatar.avatars.splats import SplatAvatar, SplatState
from deblur_avatar.avatars.weight_offsets import WeightOffsets, nearest_weights
from deblur_avatar.config.section import Count, Params, Positive
from deblur_avatar.geometry.cameras import camera_centres
from deblur_avatar.geometry.skinning import blend_transforms, transform_points
from deblur_avatar.rendering.covariance_factors import covariance_factors


class WeightOffsetsParams(Params):
    """The network that re-weighs blend weights."""

    frequencies: Count  # of the encoding of positions
    hidden: tuple[Count, ...] = Field(min_length=2)


class GauhumanParams(AvatarParams):
    """Weight offsets, and spherical harmonics up to a degree."""

    kind: Literal["gauhuman"]
    weight_offsets: WeightOffsetsParams
    harmonics: Degree


class WeightOffsetsFitting(Params):
    """How the weight offsets are fitted."""

    rate: Positive


class GauhumanFitting(HarmonicFitting):
    """How Gaussians and weight offsets are fitted."""

    weight_offsets: WeightOffsetsFitting
    densify: KlDensifyParams

    def learning_rates(self, final_share: float) -> dict[str, LearningRate]:
        """Those of the Gaussians and of the network."""
        return super().learning_rates(final_share) | {
            "weight_offsets": LearningRate(self.weight_offsets.rate, final_share)
        }


class GauhumanAvatar(SplatAvatar):
    """Gaussians, and the network that re-weighs their blend weights.

    Source: GauHuman, Hu et al., CVPR 2024 (where this departs: docs/decisions/0042-gauhuman.md).
    """

    kind = "gauhuman"
    Params: ClassVar[type[AvatarParams]] = GauhumanParams
    Fitting: ClassVar[type[FittingParams]] = GauhumanFitting
    beyond_a_rig: ClassVar[str] = "whose colours depend on the view, which no skeleton carries"
    params: GauhumanParams

    def __init__(
        self, params: GauhumanParams, gaussians: Gaussians, body: Body, betas: Tensor, frames: int,
        averaging_space: str,
    ) -> None:  # fmt: skip
        super().__init__(params, gaussians, body, betas, frames, averaging_space)
        offsets = params.weight_offsets
        self.weight_offsets = WeightOffsets(len(body.parents), offsets.frequencies, offsets.hidden)

    @staticmethod
    def features(params: GauhumanParams) -> int:
        """Coefficients of the harmonics."""
        return harmonic_features(params.harmonics)

    @property
    def precision(self) -> Precision:
        """That of the weight offsets' network."""
        return "float32"

    def condition(
        self,
        rotations: Float[Tensor, "J 3 3"],
        frame: int,
        transforms: Float[Tensor, "J 4 4"],
        viewmat: Float[Tensor, "4 4"],
        step: TrainingStep | None = None,
    ) -> SplatState:
        """Weigh and colour the Gaussians; no frame differs from another in anything else."""
        gaussians = self.gaussians
        weights = self.weights_at(gaussians.means)
        blended = blend_transforms(weights, transforms)
        posed = transform_points(blended, gaussians.means)
        directions = seen_from(blended[:, :3, :3], posed, camera_centres(viewmat))
        up_at = () if step is None else step.fitting.harmonics_up_at
        degree = degree_at(step, self.params.harmonics, up_at)
        colors = harmonic_colors(gaussians.features, directions, degree)
        factors = covariance_factors(gaussians.quats, gaussians.scales)
        return SplatState(frame, None, gaussians.means, factors, weights, colors)

    def weights_at(self, means: Float[Tensor, "N 3"]) -> Float[Tensor, "N J"]:
        """Weights of the vertices that were nearest when last looked up, re-weighed."""
        own = self.gaussians.means
        if self._found is None or self._found[0] is not own:
            weights = self.body.lbs_weights
            self._found = own, nearest_weights(own, self.canonical_vertices, weights)
        return self.weight_offsets(means, self._found[1])

    def edits(
        self,
        pulls: Float[Tensor, " N"],
        params: Any,
        room: int,
        generator: torch.Generator,
    ) -> Edits:
        """Densify by divergence, near the body; `params` are of `KlDensifyParams`."""
        vertices = self.canonical_vertices
        return kl_edits(self.gaussians, pulls, params, room, vertices, generator)

    def parameter_groups(self) -> ParameterGroups:
        """Those of the Gaussians, and the network's."""
        offsets = [
            (part_on_disk(f"weight_offsets.{name}"), value)
            for name, value in self.weight_offsets.named_parameters()
        ]
        return super().parameter_groups() | {"weight_offsets": offsets}
