"""Robust costs of squared distances in standard deviations: detectors are not noisy but wrong."""

from torch import Tensor

SATURATION = 3.0  # standard deviations at which a measurement has half its say


def saturating(squared: Tensor) -> Tensor:
    """Geman and McClure's cost: what is far off costs the same wherever it is."""
    return squared / (1 + squared / SATURATION**2)


def growing(squared: Tensor) -> Tensor:
    """Charbonnier's cost: square near zero, straight far off, where it still pulls."""
    return 2 * ((1 + squared).sqrt() - 1)
