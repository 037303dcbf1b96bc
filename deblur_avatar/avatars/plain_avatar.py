"""Avatars without networks: one colour a Gaussian, blend weights of the body (`lean`'s)."""

from collections.abc import Mapping
from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.avatars.avatar import Regularisers, TrainingStep
from deblur_avatar.avatars.closure import ClosureView, closure_views, open_share, unmoved
from deblur_avatar.avatars.knn_smoothness import knn_smoothness
from deblur_avatar.avatars.params import AvatarParams, FittingParams, SplatFitting
from deblur_avatar.avatars.regularisers import elongation
from deblur_avatar.avatars.splats import SplatAvatar, SplatRendering, SplatState
from deblur_avatar.avatars.surface_projection import SurfaceProjection, closest_points
from deblur_avatar.config.section import Count, NonNegative, Params
from deblur_avatar.rendering.covariance_factors import covariance_factors

COLORS = 3  # raw colours, the logits of what is rendered
# Metres off the body that weigh like a unit of a raw colour. Not a parameter: a unit, beside the
# weight of the penalty.
HEIGHT = 0.01


# Times its width that a Gaussian may be long. Not a parameter: a flat one may fill a gap between
# its neighbours, a longer one sticks out where only another camera would see it.
LONGEST = 2.0
# Share of the body that no frame shows from where on the surface has to be closed by more than
# pictures. Not a parameter: a person whom the camera sees from all sides has 0.04 to 0.07, one who
# is filmed from one side 0.43, and of those between, limbs of one with 0.17 were torn.
PART_SEEN = 0.1
LOOKS_EVERY = 3  # steps: as good as in each, at a third of the time


class PlainParams(AvatarParams):
    """Nothing to choose."""

    kind: Literal["plain"]


class SmoothnessParams(Params):
    """Weights of the k-nearest-neighbour smoothness, of a body of which nothing is seen."""

    smooth_colors: NonNegative  # neighbours' raw colours are alike
    smooth_shapes: NonNegative  # their raw scales and opacities
    smooth_heights: NonNegative  # and how far they stand off the body
    needles: NonNegative  # no Gaussian is much longer than it is wide; whatever is seen
    closed: NonNegative  # nothing is seen through the body, of a person part of whom is never seen


class PlainFitting(SplatFitting):
    """Gaussians that take after their neighbours.

    With more than `rate_holds_to` of them, the rate of their positions falls as their spacing
    does, so that a step stays the same share of it.
    """

    rate_holds_to: Count
    regularisers: SmoothnessParams

    def pace_of_means(self, gaussians: int) -> float:
        """The ratio of spacings on a surface."""
        return min(1.0, (self.rate_holds_to / gaussians) ** 0.5)

    def weights(self, step: TrainingStep, occluded_fraction: float) -> Mapping[str, float]:
        """By the square of the occluded fraction; needles, which point at the camera, by none."""
        shares = {"needles": 1.0, "closed": float(occluded_fraction > PART_SEEN)}
        return {
            name: shares.get(name, occluded_fraction**2) * value
            for name, value in self.regularisers.model_dump().items()
        }


class PlainAvatar(SplatAvatar):
    """Gaussians that move with the body's own blend weights, in colours of their own."""

    kind = "plain"
    Params: ClassVar[type[AvatarParams]] = PlainParams
    Fitting: ClassVar[type[FittingParams]] = PlainFitting
    _projection: SurfaceProjection | None = None
    _views: list[ClosureView] | None = None

    @staticmethod
    def features(params: AvatarParams) -> int:
        """Raw colours."""
        return COLORS

    def condition(
        self,
        rotations: Float[Tensor, "J 3 3"],
        frame: int,
        transforms: Float[Tensor, "J 4 4"],
        viewmat: Float[Tensor, "4 4"],
        step: TrainingStep | None = None,
    ) -> SplatState:
        """The canonical Gaussians as they are: no frame differs from another."""
        gaussians = self.gaussians
        factors = covariance_factors(gaussians.quats, gaussians.scales)
        weights = self.weights_at(gaussians.means)
        colors = gaussians.features[:, :COLORS].sigmoid()
        return SplatState(frame, None, gaussians.means, factors, weights, colors)

    def regularisers(self, rendering: SplatRendering, step: TrainingStep) -> Regularisers:
        """Gaussians are like their neighbours, so that those that no frame shows are, too."""
        gaussians = self.gaussians

        def smooth(values: Tensor) -> Tensor:
            return knn_smoothness(values, self.neighbours())

        def shapes() -> Tensor:
            return torch.cat([gaussians.log_scales, gaussians.opacity_logits[:, None]], dim=1)

        def heights() -> Tensor:
            return self._surface().heights(gaussians.means)[:, None] / HEIGHT

        terms = {
            "smooth_colors": lambda: smooth(gaussians.features),
            "smooth_shapes": lambda: smooth(shapes()),
            "smooth_heights": lambda: smooth(heights()),
            "needles": lambda: elongation(gaussians.log_scales, LONGEST),
        }
        look, between = divmod(step.iteration, LOOKS_EVERY)
        return terms if between else terms | {"closed": lambda: self._open_share(look, step)}

    def _open_share(self, look: int, step: TrainingStep) -> Tensor:
        """How much light passes through the canonical avatar, from one side after the other."""
        rotations = unmoved(self)[0, :, :3, :3]
        return LOOKS_EVERY * open_share(self._view(look).coverage(self, rotations, 0, step))

    def _view(self, look: int) -> ClosureView:
        """One look at the canonical avatar, from one side after the other."""
        if self._views is None:
            self._views = closure_views(self.canonical_vertices, self.body, self.closed_nearer)
        return self._views[look % len(self._views)]

    def invalidate_neighbours(self) -> None:
        """Forget where Gaussians stood on the surface, too."""
        super().invalidate_neighbours()
        self._projection = None

    def _surface(self) -> SurfaceProjection:
        if self._projection is None:
            faces = self.body.faces.to(self.betas.device)
            self._projection = closest_points(self.gaussians.means, self.canonical_vertices, faces)
        return self._projection
