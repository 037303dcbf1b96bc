"""Parameters of avatars with networks: which there are, and how each is fitted."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, model_validator

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.params import (
    AvatarParams,
    Iteration,
    LearningRate,
    Precision,
    SplatFitting,
)
from deblur_avatar.config.section import Count, NonNegative, Params, Positive


class NonRigidParams(Params):
    """The network that moves clothes with the pose."""

    bins: Count  # of the one-blob encoding, per axis
    hidden: tuple[Count, ...]
    codes: Annotated[int, Field(ge=0)]  # numbers handed on to the colours


class SkinningParams(Params):
    """The network that learns blend weights; None means the body's own."""

    hidden: tuple[Count, ...]
    pretrain: Annotated[int, Field(ge=0)]  # iterations on the body's own weights before anything


class ColorParams(Params):
    """The network that colours; None means one colour a Gaussian."""

    features: Count
    hidden: tuple[Count, ...]
    latent: Count
    view_noise_degrees: NonNegative


class NetworksParams(AvatarParams):
    """Which networks the avatar has; `precision` is that of their layers."""

    kind: Literal["networks"]
    precision: Precision
    nonrigid: NonRigidParams | None
    skinning: SkinningParams | None
    color: ColorParams | None

    @model_validator(mode="after")
    def _some_network(self) -> "NetworksParams":
        if self.nonrigid is None and self.skinning is None and self.color is None:
            raise ValueError("an avatar without networks is of kind plain")
        return self


class NonRigidFitting(Params):
    """How the non-rigid network is fitted."""

    rate: Positive  # and the pose encoder's
    start: Iteration  # before it the avatar is rigid
    pose_noise: NonNegative  # of the conditioning rotations, in half of the steps


class SkinningFitting(Params):
    """How the skinning network is fitted."""

    rate: Positive
    early: NonNegative  # weight of the distance from the body's own weights, until `switch`
    late: NonNegative
    switch: Iteration


class ColorFitting(Params):
    """How the colour network is fitted."""

    rate: Positive
    latent_decay: NonNegative  # of the frames' codes


class IsometryParams(Params):
    """Weights of isometry: neighbours keep their distances when the body moves."""

    isometry_means: NonNegative
    isometry_covars: NonNegative


class NetworksFitting(SplatFitting):
    """How Gaussians and networks are fitted; each network that there is has its section."""

    regularisers: IsometryParams
    nonrigid: NonRigidFitting | None
    skinning: SkinningFitting | None
    color: ColorFitting | None
    max_norm: Positive  # of all networks' gradients

    @property
    def clip(self) -> float:
        """Norm to which the networks' gradients are clipped together."""
        return self.max_norm

    def learning_rates(self, final_share: float) -> dict[str, LearningRate]:
        """Those of the Gaussians, of each network, and of the frames' latent codes."""
        rates = super().learning_rates(final_share)
        if self.skinning is not None:
            rates["skinning"] = LearningRate(self.skinning.rate, final_share)
        if self.nonrigid is not None:
            rates["nonrigid"] = LearningRate(self.nonrigid.rate, final_share)
        if self.color is not None:
            rate, decay = self.color.rate, self.color.latent_decay
            rates["color"] = LearningRate(rate, final_share)
            rates["latents"] = LearningRate(rate, final_share, weight_decay=decay)
        return rates

    def weights(self, step: TrainingStep, occluded_fraction: float) -> Mapping[str, float]:
        """Isometry's, and that of the distance from the body's blend weights."""
        weights = self.regularisers.model_dump()
        if self.skinning is not None:
            own = self.skinning
            weights["skinning"] = own.late if step.past(own.switch) else own.early
        return weights

    def check(self, model: NetworksParams) -> None:
        """Refuse to fit a network that there is not, or none that there is."""
        for part in ("nonrigid", "skinning", "color"):
            if (getattr(self, part) is None) != (getattr(model, part) is None):
                raise ValueError(f"{part} must be null in both model and fitting, or in neither")
