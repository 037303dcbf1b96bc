"""Overlap of mattes."""

import torch
from jaxtyping import Float
from torch import Tensor


def soft_iou(one: Float[Tensor, "*size"], other: Float[Tensor, "*size"]) -> float | None:
    """Intersection over union: of what two mattes cover, what both do; None where neither does."""
    union = torch.maximum(one, other).sum()
    return float(torch.minimum(one, other).sum() / union) if union else None
