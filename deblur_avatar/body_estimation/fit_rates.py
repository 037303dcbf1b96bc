"""Learning rates of a body fit over its coarse and its fine steps."""

import math

from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR, LRScheduler

FINE_RATE = 0.3  # of the rates, with which the fine steps begin


def fit_rates(optimiser: Optimizer, coarse: int, fine: int) -> LRScheduler:
    """How an optimiser's rates fall: along one cosine to `FINE_RATE`, along another to nothing.

    A fine step's losses saturate: a joint that a large step throws beside its landmark stays there.

    Args:
        optimiser: with the rates to begin with.
        coarse: steps with losses that do not saturate.
        fine: steps after them, with losses that do.
    """

    def share(step: int) -> float:
        if step < coarse:
            return FINE_RATE + (1 - FINE_RATE) * _falling(step / coarse)
        return FINE_RATE * _falling((step - coarse) / fine)

    return LambdaLR(optimiser, share)


def _falling(done: float) -> float:
    return 0.5 * (1 + math.cos(math.pi * done))
