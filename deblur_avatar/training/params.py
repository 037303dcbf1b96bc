"""Training recipe: what an avatar is made of, and how it is fitted."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import TypeAdapter, field_validator, model_validator

from deblur_avatar.avatars.kinds import AVATARS, AnyAvatarParams
from deblur_avatar.avatars.params import AvatarParams
from deblur_avatar.config.section import Fraction, Params
from deblur_avatar.config.weights import WeightsOf
from deblur_avatar.motion.trajectory import MotionParams
from deblur_avatar.training.fusion_network import FusionNetworkParams
from deblur_avatar.training.losses import LOSSES
from deblur_avatar.training.schedule import ScheduleParams


class RecipeParams(Params):
    """What an avatar is made of and how it is fitted; methods that agree on it share a warm-up."""

    model: AnyAvatarParams
    fitting: Any  # of the model's kind: its class `Fitting`
    losses: Annotated[Mapping[str, float], WeightsOf(LOSSES)]
    mean_over: Literal["picture", "person"]  # of losses: what weights hold for, if both are cut out
    final_share: Fraction  # of the networks' and the motion's learning rates at the end
    exposure_gain: Literal["none", "frame"]  # frame: each may be brighter than the clip, or darker

    @field_validator("fitting", mode="plain")
    @classmethod
    def _of_the_kind(cls, value: Any, info: Any) -> Any:
        model = info.data.get("model")
        if not isinstance(model, AvatarParams):
            return value  # the model is refused, and that is said
        return TypeAdapter(AVATARS[model.kind].Fitting).validate_python(value)

    @model_validator(mode="after")
    def _of_the_model(self) -> "RecipeParams":
        self.fitting.check(self.model)
        return self


@dataclass(frozen=True, kw_only=True)
class FitParams:
    """All parameters of one stage of fitting."""

    recipe: RecipeParams
    motion: MotionParams
    schedule: ScheduleParams
    fusion: FusionNetworkParams | None = None
