"""Native terms: penalties whose kernel finds their gradients along with them.

A penalty is a sum over neighbours, and its gradient the same sum of slopes: one walk finds both.
"""

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


class NativeTerm(torch.autograd.Function):
    """A scalar of some tensors, which come first among its arguments.

    `forward` saves its gradients in their order, None where none is asked for, and nothing else.
    """

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        """The gradients that were found, times what comes from above."""
        found = [None if own is None else upstream * own for own in ctx.saved_tensors]
        return *found, *(None,) * (len(ctx.needs_input_grad) - len(found))
