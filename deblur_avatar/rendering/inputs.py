"""Rasterizer arguments, checked once for all backends.

The annotations here are loose on purpose: this is where a wrong shape gets its explanation.
"""

import math

import torch
from torch import Tensor

from deblur_avatar.rendering.conventions import MAX_CHANNELS


def check_inputs(
    means: Tensor,
    covars: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
    background: Tensor | None,
) -> None:
    """Refuse what no backend could render.

    Raises:
        ValueError: a shape, dtype, device or size is wrong, or the camera asks for a gradient.
    """
    if means.ndim != 3 or means.shape[-1] != 3:
        raise ValueError(f"means must be [B, N, 3], got {_shape(means)}")
    B, N, _ = means.shape
    if B < 1:
        raise ValueError("means must hold at least one pose, got B = 0")
    if tuple(covars.shape) not in {(B, N, 6), (B, N, 3, 3), (N, 6), (N, 3, 3)}:
        raise ValueError(
            f"covars must be [B, N, 6], [B, N, 3, 3] or, shared by all poses, [N, 6] or [N, 3, 3]"
            f" with B = {B} and N = {N} as in means, got {_shape(covars)}"
        )
    _expect("opacities", opacities, (N,))
    if colors.ndim != 2 or len(colors) != N or not 1 <= colors.shape[1] <= MAX_CHANNELS:
        raise ValueError(
            f"colors must be [N, C] with N = {N} as in means and C from 1 to {MAX_CHANNELS},"
            f" got {_shape(colors)}"
        )
    _expect("viewmat", viewmat, (4, 4))
    _expect("K", K, (3, 3))
    if background is not None:
        _expect("background", background, (colors.shape[1],))
    _check_dtype_and_device(means, covars, opacities, colors, viewmat, K, background)
    if width < 1 or height < 1:
        raise ValueError(f"the image must have at least one pixel, got {width} x {height}")
    for name, tensor in (("viewmat", viewmat), ("K", K)):
        if tensor.requires_grad:
            raise ValueError(
                f"{name} requires a gradient, which no backend computes; apply the camera's motion"
                " to means and covars instead and keep the camera fixed"
            )


def _check_dtype_and_device(means: Tensor, *others: Tensor | None) -> None:
    if means.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"means must be float32 or float64, got {means.dtype}")
    names = ("covars", "opacities", "colors", "viewmat", "K", "background")
    for name, tensor in zip(names, others, strict=True):
        if tensor is None:
            continue
        if tensor.dtype != means.dtype:
            raise ValueError(f"{name} must be {means.dtype} as means is, got {tensor.dtype}")
        if tensor.device != means.device:
            raise ValueError(f"{name} must be on {means.device} as means is, got {tensor.device}")


def check_camera(viewmat: Tensor, K: Tensor) -> None:
    """Refuse cameras that are not a rigid motion followed by a pinhole.

    Raises:
        ValueError: not finite, the last rows are not those of such matrices, a focal length is not
            positive, or the pixels are skewed.
    """
    # One transfer of both: on a GPU each waits for all that was asked of it before.
    numbers = torch.cat([viewmat.flatten(), K.flatten()]).tolist()
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError("viewmat and K must be finite")
    view_last, (focal_x, skew, _, below, focal_y, _, *k_last) = numbers[12:16], numbers[16:]
    if view_last != [0, 0, 0, 1]:
        raise ValueError(f"the last row of viewmat must be [0, 0, 0, 1], got {view_last}")
    if k_last != [0, 0, 1] or skew != 0 or below != 0 or focal_x <= 0 or focal_y <= 0:
        raise ValueError(
            "K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths,"
            f" got {K.tolist()}"
        )


def refuse_not_finite(**tensors: Tensor | None) -> None:
    """Refuse NaN and infinity.

    Raises:
        ValueError: naming the first tensor that holds one.
    """
    given = {name: tensor for name, tensor in tensors.items() if tensor is not None}
    # One call and one transfer of all; lengths of numbers too large to be squared are looked into.
    lengths = torch.stack(torch._foreach_norm([tensor.detach() for tensor in given.values()]))
    if all(map(math.isfinite, lengths.tolist())):
        return
    finite = torch.stack([torch.isfinite(tensor).all() for tensor in given.values()])
    for name, fine in zip(given, finite.tolist(), strict=True):
        if not fine:
            raise ValueError(not_finite(name))


def not_finite(name: str) -> str:
    """Say that a tensor holds NaN or infinity."""
    return f"{name} must be finite, got NaN or infinity"


def _expect(name: str, tensor: Tensor, shape: tuple[int, ...]) -> None:
    if tuple(tensor.shape) != shape:
        raise ValueError(f"{name} must be {list(shape)}, got {_shape(tensor)}")


def _shape(tensor: Tensor) -> list[int]:
    return list(tensor.shape)
