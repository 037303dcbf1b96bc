"""Registry of sources: the kinds by the name that `clip.source` gives them."""

from typing import Annotated

from deblur_avatar.config.kinds import KindOf
from deblur_avatar.sources.high_speed import HighSpeedParams
from deblur_avatar.sources.monocular import MonocularParams
from deblur_avatar.sources.multiview import MultiviewParams
from deblur_avatar.sources.source import Source
from deblur_avatar.sources.studio.source import StudioParams
from deblur_avatar.sources.studio.street import StreetParams
from deblur_avatar.sources.studio.unfitted_studio import UnfittedStudioParams
from deblur_avatar.sources.zju_mocap.source import ZjuMocapParams

SOURCES: dict[str, type[Source]] = {
    "studio": StudioParams,
    "unfitted_studio": UnfittedStudioParams,
    "street": StreetParams,
    "multiview": MultiviewParams,
    "monocular": MonocularParams,
    "high_speed": HighSpeedParams,
    "zju_mocap": ZjuMocapParams,
}

ClipParams = Annotated[Source, KindOf("source", SOURCES)]
