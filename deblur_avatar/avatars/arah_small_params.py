"""Parameters of ARAH's reduced avatars: of what they are made, and how each part is fitted."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.params import AvatarParams, FittingParams, LearningRate, Precision
from deblur_avatar.avatars.pixel_patches import RaysParams
from deblur_avatar.avatars.surface_search import SamplesParams
from deblur_avatar.config.section import Count, NonNegative, Params, Positive

Layers = Annotated[tuple[Count, ...], Field(min_length=1)]


class SdfParams(Params):
    """The signed distance field."""

    hidden: Layers
    frequency: Positive  # of its sines
    latent: Count  # numbers that are a frame's own
    width_m: Positive  # of the densities round the surface, at first
    pretrain: Annotated[int, Field(ge=0)]  # iterations with the body's distances


class ForwardSkinningParams(Params):
    """The skinning network, and the grid that it is baked into for searches."""

    hidden: Layers
    pretrain: Annotated[int, Field(ge=0)]  # iterations with the body's weights
    nodes: Annotated[int, Field(ge=2)]  # of the grid, along each axis


class SurfaceColorParams(Params):
    """The network of colours."""

    hidden: Layers


class ArahSmallParams(AvatarParams):
    """A signed distance field in the canonical pose, forward skinning, colours of its surface."""

    kind: Literal["arah_small"]
    precision: Precision  # of the layers of skinning and colours
    sdf: SdfParams
    skinning: ForwardSkinningParams
    color: SurfaceColorParams
    samples: SamplesParams


class ArahRates(Params):
    """Learning rates."""

    sdf: Positive  # and of the pose encoder
    color: Positive
    width: Positive  # of its logarithm
    latents: Positive
    skinning: Positive


class ArahRegularisers(Params):
    """Weights of what surface and skinning are held to."""

    eikonal: NonNegative  # gradients of distances from length 1
    off_surface: NonNegative  # small distances far from the body
    inside: NonNegative  # positive distances deep in the body
    skinning: NonNegative  # blend weights from the body's own


class ArahSmallFitting(FittingParams):
    """How surface, colours and skinning are fitted."""

    rates: ArahRates
    latent_decay: NonNegative  # of the frames' codes
    pose_noise: NonNegative  # of the conditioning rotations, in half of the steps
    regularisers: ArahRegularisers
    rays: RaysParams

    def learning_rates(self, final_share: float) -> dict[str, LearningRate]:
        """One a part; all of them fall."""
        rates = {
            name: LearningRate(rate, final_share) for name, rate in self.rates.model_dump().items()
        }
        decay = self.latent_decay
        latents = LearningRate(self.rates.latents, final_share, weight_decay=decay)
        return rates | {"latents": latents}

    def weights(self, step: TrainingStep, occluded_fraction: float) -> Mapping[str, float]:
        """The same at every step, whatever is hidden."""
        return self.regularisers.model_dump()
