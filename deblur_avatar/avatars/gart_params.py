"""Parameters of GART's avatars: of what they are made, and how each part is fitted."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.harmonic_colors import Degree, HarmonicFitting
from deblur_avatar.avatars.params import AvatarParams, Iteration, LearningRate
from deblur_avatar.config.section import Count, NonNegative, Params, Positive, Share

Nodes = Annotated[int, Field(ge=3)]  # with fewer none is inside
BeforeTheEnd = Annotated[float, Field(ge=0, lt=1)]


@dataclass(frozen=True)
class HeldRate(LearningRate):
    """A rate that stays as it is for a share of the run, and then falls as others do."""

    held: float = 0.0

    def at(self, share: float) -> float:
        """The rate at a share of the run."""
        return super().at(max(0.0, share - self.held) / (1 - self.held))


class WeightVolumeParams(Params):
    """The grid of blend weights."""

    nodes: tuple[Nodes, Nodes, Nodes]  # along z, y and x
    smoothing: Annotated[int, Field(ge=0)]  # rounds, of the body's own weights


class LatentBonesParams(Params):
    """Bones without a joint, and the network that moves them with the pose."""

    count: Count
    hidden: tuple[Count, ...]


class GartParams(AvatarParams):
    """A weight volume, latent bones, spherical harmonics up to a degree."""

    kind: Literal["gart"]
    volume: WeightVolumeParams
    latent_bones: LatentBonesParams
    harmonics: Degree


class VolumeFitting(Params):
    """How the volume is fitted: learning rates, held for a share of the run and then falling."""

    corrections: Positive  # of the joints' weights
    latent: Positive  # of the latent bones' weights
    held: BeforeTheEnd
    final_share: Share  # of both at the end


class BonesFitting(Params):
    """How the latent bones' network is fitted."""

    rate: Positive
    start: Iteration  # before it bones stay as they began; their weights do not


class GartRegularisers(Params):
    """Weights of what GART holds its Gaussians and its volume to."""

    std_quats: NonNegative  # deviations within neighbourhoods: of raw quaternions,
    std_scales: NonNegative  # of standard deviations in metres,
    std_opacities: NonNegative
    std_colors: NonNegative  # of constant coefficients,
    std_harmonics: NonNegative  # and of the others
    tv_weights: NonNegative  # total variation of the corrections
    tv_latent: NonNegative  # and of the latent bones' weights
    size_weights: NonNegative  # magnitude of the corrections
    size_latent: NonNegative  # and of the latent bones' weights
    size_scales: NonNegative  # squared largest scale, square metres


class GartFitting(HarmonicFitting):
    """How Gaussians, volume and latent bones are fitted."""

    volume: VolumeFitting
    latent_bones: BonesFitting
    regularisers: GartRegularisers

    def learning_rates(self, final_share: float) -> dict[str, LearningRate]:
        """Those of the Gaussians, of both parts of the volume, and of the bones' network."""
        volume = self.volume
        return super().learning_rates(final_share) | {
            "corrections": HeldRate(volume.corrections, volume.final_share, held=volume.held),
            "latent": HeldRate(volume.latent, volume.final_share, held=volume.held),
            "bones": LearningRate(self.latent_bones.rate, final_share),
        }

    def weights(self, step: TrainingStep, occluded_fraction: float) -> Mapping[str, float]:
        """The same at every step, whatever is hidden."""
        return self.regularisers.model_dump()
