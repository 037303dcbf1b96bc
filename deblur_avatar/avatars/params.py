"""Parameters that kinds of avatars share: of what they are made, and how they are fitted.

Iterations count as in the paper's 15,000.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from deblur_avatar.config.section import (
    Count,
    Fraction,
    Params,
    Positive,
)

# Of the layers of a network: float32, or products of bfloat16 summed in float32.
Precision = Literal["float32", "bfloat16"]
Iteration = Annotated[int, Field(ge=0)]


@dataclass(frozen=True)
class LearningRate:
    """How fast the parameters of a group move: `first * ratio ** (share of the run / span)`."""

    first: float
    ratio: float = 1.0
    span: float = 1.0  # runs
    weight_decay: float = 0.0

    def at(self, share: float) -> float:
        """The rate at a share of the run."""
        return self.first * self.ratio ** (share / self.span)


class AvatarParams(Params):
    """What an avatar is made of; each kind adds its own, beside its class."""

    kind: str


class FittingParams(Params):
    """How an avatar of one kind is fitted; each kind adds its own, beside its class."""

    @property
    def clip(self) -> float | None:
        """Norm to which the gradients of all but the Gaussians are clipped together."""
        return None

    def learning_rates(self, final_share: float) -> dict[str, LearningRate]:
        """The rate of each parameter group; `final_share` is that of the networks at the end."""
        return {}

    def weights(self, step: Any, occluded_fraction: float) -> Mapping[str, float]:
        """Weights of the avatar's regularisers.

        Args:
            step: of fitting (`TrainingStep`).
            occluded_fraction: share of the body that no frame shows.
        """
        return {}

    def pace_of_means(self, gaussians: int) -> float:
        """By how much the rate of positions is multiplied, with so many Gaussians."""
        return 1.0

    def check(self, model: Any) -> None:
        """Refuse settings of parts that an avatar does not have.

        Raises:
            ValueError: naming them.
        """


class DensifyParams(Params):
    """Where Gaussians are added and taken away."""

    start: Count
    stop: Count
    every: Count
    gradient: Positive  # of the screen position, in half image widths
    clone_below_m: Positive
    prune_opacity: Fraction
    prune_scale_m: Positive
    max_growth: Positive  # times the first count


class GaussianRates(Params):
    """Learning rates of Gaussians."""

    means: Positive
    means_final: Positive  # log-linear over twice the run, as in the authors' code
    features: Positive
    opacities: Positive
    scales: Positive
    quats: Positive


class SplatFitting(FittingParams):
    """How an avatar of Gaussians is fitted."""

    rates: GaussianRates
    gaussians_start: Iteration
    densify: DensifyParams

    def learning_rates(self, final_share: float) -> dict[str, LearningRate]:
        """Those of the Gaussians."""
        rates = self.rates
        return {
            "means": LearningRate(rates.means, rates.means_final / rates.means, span=2.0),
            "quats": LearningRate(rates.quats),
            "scales": LearningRate(rates.scales),
            "opacities": LearningRate(rates.opacities),
            "features": LearningRate(rates.features),
        }
