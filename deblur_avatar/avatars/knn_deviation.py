"""k-nearest-neighbour deviation: how much a Gaussian and those nearest to it differ.

Conventions. N Gaussians, K others near each.
"""

import torch
from jaxtyping import Float, Int64
from torch import Tensor


def knn_deviation(
    values: Float[Tensor, "N D"], neighbours: Int64[Tensor, "N K"]
) -> Float[Tensor, ""]:
    """Mean standard deviation of values within neighbourhoods; 0 without any.

    A neighbourhood is a Gaussian and its neighbours; deviations are unbiased. Where all of them
    are the same there is no gradient.

    Source: GART (Lei et al., CVPR 2024).
    """
    # [D, K + 1, N]: rows without strides, as `knn_smoothness_reference` has them.
    rows, near = values.T.contiguous(), neighbours.T.contiguous()
    others = rows.index_select(1, near.flatten()).unflatten(1, near.shape)
    members = torch.cat([rows[:, None], others], dim=1)
    apart = members - members.mean(1, keepdim=True)
    variance = apart.square().sum(1) / max(1, len(near))
    # Not `std`: of equal values its gradient is not a number.
    deviation = variance.clamp(min=torch.finfo(values.dtype).tiny).sqrt()
    return deviation.sum() / max(1, deviation.numel())
