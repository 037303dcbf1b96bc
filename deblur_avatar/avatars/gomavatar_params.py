"""Parameters of GoMAvatar's avatars: of what they are made, and how each part is fitted."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, model_validator

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.params import AvatarParams, FittingParams, Iteration, LearningRate
from deblur_avatar.config.section import Count, NonNegative, Params, Positive


class EncodedNetworkParams(Params):
    """A network that sees encoded positions or directions."""

    frequencies: Count  # of the encoding
    hidden: Annotated[tuple[Count, ...], Field(min_length=1)]


class GomavatarParams(AvatarParams):
    """The body's mesh with a Gaussian a face, shading by normals, offsets of vertices."""

    kind: Literal["gomavatar"]
    thickness_m: Positive  # of the Gaussians along the normal
    shading: EncodedNetworkParams
    nonrigid: EncodedNetworkParams


class MeshRates(Params):
    """Learning rates of the mesh, of its Gaussians, and of shading."""

    vertices: Positive
    turns: Positive  # of the Gaussians in their faces' frames
    scales: Positive
    colors: Positive
    shading: Positive


class OffsetsFitting(Params):
    """How a network that moves vertices, or points, with the pose is fitted."""

    rate: Positive
    start: Iteration  # before it they follow the joints alone
    full: Iteration  # from here on it sees all frequencies

    @model_validator(mode="after")
    def _in_order(self) -> "OffsetsFitting":
        if self.full <= self.start:
            raise ValueError(f"full must be after start = {self.start}, got {self.full}")
        return self

    def opened(self, step: TrainingStep) -> float | None:
        """How far the network's window is open at a step: 0 to 1 and on; None while it waits."""
        if not step.past(self.start):
            return None
        return (step.iteration / step.scale - self.start) / (self.full - self.start)


class MeshRegularisers(Params):
    """Weights of what the mesh is held to."""

    laplacian: NonNegative  # vertices from the middle of their neighbours, square metres
    normal_consistency: NonNegative  # faces that share an edge: angles,
    color_consistency: NonNegative  # and colours


class GomavatarFitting(FittingParams):
    """How mesh, Gaussians and networks are fitted."""

    rates: MeshRates
    nonrigid: OffsetsFitting
    regularisers: MeshRegularisers

    def learning_rates(self, final_share: float) -> dict[str, LearningRate]:
        """One a group; all of them fall."""
        rates = {**self.rates.model_dump(), "nonrigid": self.nonrigid.rate}
        return {name: LearningRate(rate, final_share) for name, rate in rates.items()}

    def weights(self, step: TrainingStep, occluded_fraction: float) -> Mapping[str, float]:
        """The same at every step, whatever is hidden."""
        return self.regularisers.model_dump()
