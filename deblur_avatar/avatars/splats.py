"""Avatars of canonical Gaussians, skinned and rendered by the rasterizer: what their kinds share.

Conventions. What does not depend on the instant inside an exposure is evaluated once a frame: blend
weights, the square root of each covariance, colours. *Posing* applies S sets of joint transforms
to it in one batch. World coordinates, metres. N Gaussians.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.avatar import (
    AvatarModel,
    FrameState,
    ParameterGroups,
    Rendering,
    canonical_vertices,
)
from deblur_avatar.avatars.gaussians import (
    Gaussians,
    gaussians_on_surface,
    neighbour_indices,
)
from deblur_avatar.avatars.skinning_field import surface_weights
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.rendering.conventions import eps2d_of
from deblur_avatar.rendering.covariance_factors import covariance_factors, covariances
from deblur_avatar.rendering.posing import pose_gaussians
from deblur_avatar.rendering.rasterize import rasterize

# 3DGS-Avatar: five nearest, the point itself among them. Not a parameter: weights are tuned to it.
KNN = 4


@dataclass(frozen=True)
class SplatState(FrameState):
    """One frame's canonical Gaussians, ready to be posed at any of its instants."""

    means: Float[Tensor, "N 3"]
    # Rotation times scales: the covariance is covariance_factors covariance_factors^T.
    covariance_factors: Float[Tensor, "N 3 3"]
    lbs_weights: Float[Tensor, "N J"]
    colors: Float[Tensor, "N 3"]  # in the space in which light is averaged

    def posed(
        self, transforms: Float[Tensor, "S J 4 4"]
    ) -> tuple[Float[Tensor, "S N 3"], Float[Tensor, "S N 6"]]:
        """Means and covariances (upper triangles) at S instants."""
        return pose_gaussians(self.means, self.covariance_factors, self.lbs_weights, transforms)


@dataclass(frozen=True)
class SplatRendering(Rendering):
    """Renders of Gaussians, and where these were at the S instants."""

    means: Float[Tensor, "S N 3"]
    covars: Float[Tensor, "S N 6"]


class SplatAvatar(AvatarModel):
    """Canonical Gaussians; a kind says how they are deformed, skinned and coloured."""

    gaussians: Gaussians
    knn: ClassVar[int] = KNN  # of `neighbours`

    def __init__(
        self,
        params: Any,
        gaussians: Gaussians,
        body: Body,
        betas: Tensor,
        frames: int,
        averaging_space: str,
    ) -> None:
        super().__init__(params, body, betas, frames, averaging_space)
        self.gaussians = gaussians
        # The means that have been looked up on the body, and the weights found there.
        self._found: tuple[Tensor, Tensor] | None = None
        self._neighbours: Tensor | None = None

    @staticmethod
    @abstractmethod
    def features(params: Any) -> int:
        """How many appearance numbers a Gaussian has."""

    @classmethod
    def create(
        cls, params: Any, body: Body, betas: Tensor, frames: int, count: int, averaging_space: str,
        generator: torch.Generator,
    ) -> "SplatAvatar":  # fmt: skip
        """A new avatar of `count` Gaussians on the canonical body's surface."""
        gaussians = gaussians_on_surface(
            canonical_vertices(body, betas), body.faces.to(betas.device), count,
            cls.features(params), generator,
        )  # fmt: skip
        return cls(params, gaussians, body, betas, frames, averaging_space)

    @classmethod
    def rebuilt(cls, avatar: Avatar, params: Any, body: Body) -> "SplatAvatar":
        """The avatar that was saved, with its Gaussians."""
        # Clones: fitting works in place, and an artifact never changes.
        gaussians = Gaussians(
            avatar.means.clone(), avatar.quats.clone(), avatar.log_scales.clone(),
            avatar.opacity_logits.clone(), avatar.features.clone(),
        )  # fmt: skip
        saved = avatar.model
        return cls(params, gaussians, body, avatar.betas, saved["frames"], saved["light"])

    def render(
        self,
        state: SplatState,
        transforms: Float[Tensor, "S J 4 4"],
        camera: Camera,
        *,
        average: bool = False,
        background: Float[Tensor, " 3"] | None = None,
    ) -> SplatRendering:
        """Pose the Gaussians at all instants and rasterize them."""
        posed = state.posed(transforms)
        return self._rasterized(state, *posed, camera, average=average, background=background)

    def render_exposure(
        self,
        state: SplatState,
        transforms: Float[Tensor, "instants J 4 4"],
        camera: Camera,
        *,
        average: bool,
    ) -> tuple[SplatRendering, SplatRendering]:
        """The same, posed in one call, which blends each Gaussian's transforms only once."""
        sizes = [len(transforms) - 1, 1]
        means, covars = (part.split(sizes) for part in state.posed(transforms))
        return (
            self._rasterized(state, means[0], covars[0], camera, average=average),
            self._rasterized(state, means[1], covars[1], camera),
        )

    def _rasterized(
        self, state: SplatState, means: Tensor, covars: Tensor, camera: Camera, *,
        average: bool = False, background: Tensor | None = None,
    ) -> SplatRendering:  # fmt: skip
        rendered = rasterize(
            means, covars, self.gaussians.opacities, state.colors, camera.viewmat, camera.K,
            camera.width, camera.height, background=background, average=average,
            eps2d=eps2d_of(camera.binning),
        )  # fmt: skip
        return SplatRendering(rendered.image, rendered.alpha, len(means), rendered, means, covars)

    @property
    def densified(self) -> Gaussians:
        """All of them."""
        return self.gaussians

    def parameter_groups(self) -> ParameterGroups:
        """One group for each parameter of the Gaussians."""
        own = self.gaussians
        return {
            "means": [("means", own.means)],
            "quats": [("quats", own.quats)],
            "scales": [("log_scales", own.log_scales)],
            "opacities": [("opacity_logits", own.opacity_logits)],
            "features": [("features", own.features)],
        }

    def canonical_covariances(self) -> Float[Tensor, "N 6"]:
        """Covariances before any deformation."""
        gaussians = self.gaussians
        return covariances(covariance_factors(gaussians.quats, gaussians.scales))

    def weights_at(self, means: Float[Tensor, "N 3"]) -> Float[Tensor, "N J"]:
        """Blend weights of the body where each Gaussian was when it was last looked up.

        Args:
            means: where the Gaussians are after deformation, for kinds that learn weights.
        """
        own = self.gaussians.means
        if self._found is None or self._found[0] is not own:
            self._found = own, surface_weights(own, self.canonical_vertices, self.body)
        return self._found[1]

    def neighbours(self) -> Int64[Tensor, "N K"]:
        """The Gaussians nearest to each, as they were when last looked up."""
        if self._neighbours is None:
            self._neighbours = neighbour_indices(self.gaussians.means, self.knn)
        return self._neighbours

    def invalidate_neighbours(self) -> None:
        """Forget who is next to whom and where on the body, because Gaussians have moved."""
        self._found, self._neighbours = None, None
