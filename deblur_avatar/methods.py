"""Methods: what follows the warm-up, a row of every table."""

from deblur_avatar.config.section import Params
from deblur_avatar.pipeline.fusion import FusionParams
from deblur_avatar.pipeline.trajectory import TrajectoryParams


class MethodParams(Params):
    """A row of every table."""

    trajectory: TrajectoryParams
    fusion: FusionParams
