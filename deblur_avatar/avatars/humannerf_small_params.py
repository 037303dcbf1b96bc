"""Parameters of HumanNeRF's reduced avatars: of what they are made, and how each part is fitted."""

from typing import Annotated, Literal

from pydantic import Field

from deblur_avatar.avatars.gomavatar_params import EncodedNetworkParams, OffsetsFitting
from deblur_avatar.avatars.motion_weight_volume import MotionWeightsParams
from deblur_avatar.avatars.params import AvatarParams, FittingParams, LearningRate, Precision
from deblur_avatar.avatars.pixel_patches import RaysParams
from deblur_avatar.config.section import Params, Positive


class HumannerfSmallParams(AvatarParams):
    """A radiance field in the T-pose, the volume that skins it, offsets by the pose."""

    kind: Literal["humannerf_small"]
    precision: Precision  # of the radiance field's layers
    samples: Annotated[int, Field(ge=2)]  # along a ray
    field: EncodedNetworkParams
    motion_weights: MotionWeightsParams
    nonrigid: EncodedNetworkParams


class FieldRates(Params):
    """Learning rates."""

    field: Positive
    motion_weights: Positive


class HumannerfSmallFitting(FittingParams):
    """How field, motion weights and offsets are fitted."""

    rates: FieldRates
    nonrigid: OffsetsFitting
    rays: RaysParams

    def learning_rates(self, final_share: float) -> dict[str, LearningRate]:
        """One a part; all of them fall."""
        rates = {**self.rates.model_dump(), "nonrigid": self.nonrigid.rate}
        return {name: LearningRate(rate, final_share) for name, rate in rates.items()}
