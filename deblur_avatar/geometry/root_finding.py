"""Broyden's method: roots of many small systems of equations at once, without their derivatives.

Conventions. P systems of D equations in D unknowns. No gradient flows through the search; who wants
one differentiates the equations at the root.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

# Not a parameter: where the change of the residuals says less, a matrix stays as it is.
SMALLEST_CHANGE = 1e-12

# Residuals of some of the systems, by their numbers, at values of their unknowns.
Equations = Callable[[Float[Tensor, "A D"], Int64[Tensor, " A"]], Float[Tensor, "A D"]]


@dataclass(frozen=True)
class Roots:
    """The best values that were met, and the length of what they leave of the equations."""

    values: Float[Tensor, "P D"]
    residuals: Float[Tensor, " P"]

    def or_better(self, others: "Roots") -> "Roots":
        """Of each system the better one of two."""
        better = others.residuals < self.residuals
        return Roots(
            torch.where(better[:, None], others.values, self.values),
            torch.where(better, others.residuals, self.residuals),
        )


@torch.no_grad()
def broyden(
    equations: Equations,
    start: Float[Tensor, "P D"],
    inverse_jacobian: Float[Tensor, "P D D"],
    iterations: int,
    tolerance: float,
) -> Roots:
    """Search for roots, each from one start; who has found one, rests.

    Args:
        equations: what is to be 0.
        start: of the unknowns.
        inverse_jacobian: of the equations there, as far as it is known.
        iterations: at most.
        tolerance: length of the residual that counts as none.

    Source: Broyden, "A Class of Methods for Solving Nonlinear Simultaneous Equations", Mathematics
    of Computation 1965, the "good" update, as in SNARF (Chen et al., ICCV 2021) and ARAH.
    """
    rows = torch.arange(len(start), device=start.device)
    residual = equations(start, rows)
    best, least = start.clone(), residual.norm(dim=1)
    values, inverse = start, inverse_jacobian
    for _ in range(iterations):
        going = least[rows] > tolerance
        if not going.any():
            break
        rows, values, residual, inverse = (
            part[going] for part in (rows, values, residual, inverse)
        )
        step = -(inverse @ residual[..., None])[..., 0]
        values = values + step
        found = equations(values, rows)
        inverse = _updated(inverse, step, found - residual)
        residual = found
        length = residual.norm(dim=1)
        better = length < least[rows]  # not where it is no number
        best[rows[better]], least[rows[better]] = values[better], length[better]
    return Roots(best, least)


def _updated(inverse: Tensor, step: Tensor, change: Tensor) -> Tensor:
    """B + (dx - B dg) dx^T B / (dx^T B dg)."""
    predicted = (inverse @ change[..., None])[..., 0]
    along = (step[:, None] @ inverse)[:, 0]
    scale = (step * predicted).sum(1)
    known = scale.abs() > SMALLEST_CHANGE
    scale = torch.where(known, scale, torch.ones_like(scale))
    correction = (step - predicted)[:, :, None] * along[:, None] / scale[:, None, None]
    return inverse + torch.where(known[:, None, None], correction, torch.zeros_like(correction))
