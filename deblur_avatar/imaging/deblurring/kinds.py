"""Registry of deblurrers: the kinds by the name that `predeblur.<scene>.deblurrer.kind` gives."""

from typing import Annotated

from deblur_avatar.config.kinds import KindOf
from deblur_avatar.imaging.deblurring.deblurrer import Deblurrer
from deblur_avatar.imaging.deblurring.dstnet_small import DstnetSmallParams
from deblur_avatar.imaging.deblurring.matte import MatteParams

DEBLURRERS: dict[str, type[Deblurrer]] = {
    "matte": MatteParams,
    "dstnet_small": DstnetSmallParams,
}

DeblurrerParams = Annotated[Deblurrer, KindOf("kind", DEBLURRERS)]
