"""Reference rasterizer in plain torch: the definition that the fast ones are held to.

Every line differentiates itself, in float32 or float64, on any device. Two shortcuts keep it
usable where no compiler is at hand, and neither changes a value: pixels are composited in square
blocks, and a block looks only at the Gaussians whose box reaches it.

Conventions are in `conventions.py`. P is the number of pixels in a block, M of Gaussians near it.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from deblur_avatar.rendering.conventions import (
    MAX_ALPHA,
    MIN_ALPHA,
    MIN_TRANSMITTANCE,
    NEAR_PLANE,
    VIEW_MARGIN,
)
from deblur_avatar.rendering.covariances import whole_matrices
from deblur_avatar.rendering.inputs import refuse_not_finite
from deblur_avatar.rendering.result import Rasterization, ScreenStatistics

# Pixels a side: 32 makes the dense part 10x slower, 8 the python loop 3x longer.
BLOCK = 16


@dataclass(frozen=True, kw_only=True)
class Projection:
    """Gaussians as ellipses in the image.

    Attributes:
        means2d: centres, pixels.
        conics: entries xx, xy, yy of the inverse covariance, 1 / px^2.
        depths: distance of the centres along the viewing axis, metres.
        extents: half width and height of the box outside which alpha < MIN_ALPHA, pixels.
        visible: in front of the camera and with a box that meets the image.
    """

    means2d: Float[Tensor, "B N 2"]
    conics: Float[Tensor, "B N 3"]
    depths: Float[Tensor, "B N"]
    extents: Float[Tensor, "B N 2"]
    visible: Bool[Tensor, "B N"]

    @property
    def radii(self) -> Int[Tensor, "B N"]:
        """Half extent in pixels, rounded up; 0 where invisible."""
        radii = self.extents.amax(-1).ceil()
        return torch.where(self.visible, radii, 0).clamp(max=2**30).int()

    @property
    def areas(self) -> Float[Tensor, "B N"]:
        """Integrals of Gaussians of peak 1 over the plane of the image, px^2; 0 where invisible."""
        xx, xy, yy = self.conics.unbind(-1)
        return torch.where(self.visible, 2 * torch.pi * (xx * yy - xy * xy).rsqrt(), 0)


def rasterize(
    means: Float[Tensor, "B N 3"],
    covars: Float[Tensor, "*rest N 3 3"] | Float[Tensor, "*rest N 6"],
    opacities: Float[Tensor, " N"],
    colors: Float[Tensor, "N C"],
    viewmat: Float[Tensor, "4 4"],
    K: Float[Tensor, "3 3"],
    width: int,
    height: int,
    *,
    background: Float[Tensor, " C"] | None,
    average: bool,
    depth: bool,
    eps2d: float,
) -> Rasterization:
    """Rasterize with torch operations; see the package for the arguments."""
    refuse_not_finite(
        means=means, covars=covars, opacities=opacities, colors=colors, background=background
    )
    covars = whole_matrices(covars)
    covars = 0.5 * (covars + covars.mT)  # so that the gradient is symmetric too
    projection = project(means, covars, opacities, viewmat, K, width, height, eps2d)
    screen = ScreenStatistics()
    pictures = torch.stack(
        [
            _composite(projection, b, opacities, colors, width, height, background, screen)
            for b in range(len(means))
        ]
    )
    if average:
        pictures = pictures.mean(0, keepdim=True)
    image, alpha, depths = pictures.split([colors.shape[1], 1, 1], dim=-1)
    return Rasterization(
        image=image,
        alpha=alpha.squeeze(-1),
        depth=depths.squeeze(-1) if depth else None,
        radii=projection.radii,
        screen=screen,
    )


def project(
    means: Float[Tensor, "B N 3"],
    covars: Float[Tensor, "*rest N 3 3"],
    opacities: Float[Tensor, " N"],
    viewmat: Float[Tensor, "4 4"],
    K: Float[Tensor, "3 3"],
    width: int,
    height: int,
    eps2d: float,
) -> Projection:
    """Project Gaussians to the image by the linearised pinhole.

    Source: Zwicker et al., "EWA splatting", TVCG 2002, eq. 26-31; the box is that of Radl et al.,
    "StopThePop", SIGGRAPH 2024, appendix B.2.
    """
    rotation, translation = viewmat[:3, :3], viewmat[:3, 3]
    focal, centre = K[[0, 1], [0, 1]], K[:2, 2]
    size = means.new_tensor([width, height])

    points = means @ rotation.T + translation
    depths = points[..., 2]
    in_front = depths >= NEAR_PLANE
    z = torch.where(in_front, depths, 1)[..., None]  # a safe divisor first, the choice later
    slopes = points[..., :2] / z
    means2d = focal * slopes + centre

    margin = VIEW_MARGIN * 0.5 * size / focal
    clamped = torch.maximum(slopes, -centre / focal - margin)
    clamped = torch.minimum(clamped, (size - centre) / focal + margin)
    # d(pixel) / d(world) = focal / z * (rows 0 and 1 of the rotation - slope * row 2)
    jacobian = (focal / z)[..., None] * (rotation[:2] - clamped[..., None] * rotation[2])
    covars2d = jacobian @ covars @ jacobian.mT + eps2d * torch.eye(2).to(means)

    xx, xy, yy = covars2d[..., 0, 0], covars2d[..., 0, 1], covars2d[..., 1, 1]
    determinant = xx * yy - xy * xy
    solid = in_front & (determinant > 0) & (opacities >= MIN_ALPHA)
    divisor = torch.where(solid, determinant, 1)
    conics = torch.stack([yy, -xy, xx], -1) / divisor[..., None]

    with torch.no_grad():
        reach = 2 * torch.log(opacities.clamp(min=MIN_ALPHA) / MIN_ALPHA)
        extents = (reach[:, None] * torch.stack([xx, yy], -1).clamp(min=0)).sqrt()
        rounded = extents.ceil()
        inside = (means2d + rounded > 0) & (means2d - rounded < size)
        visible = solid & inside.all(-1) & (rounded > 0).any(-1)
    return Projection(
        means2d=means2d, conics=conics, depths=depths, extents=extents, visible=visible
    )


def _composite(
    projection: Projection,
    b: int,
    opacities: Tensor,
    colors: Tensor,
    width: int,
    height: int,
    background: Tensor | None,
    screen: ScreenStatistics,
) -> Float[Tensor, "H W channels"]:
    """Composite pose b: colour, alpha and depth in the last axis."""
    means2d, depths = projection.means2d[b], projection.depths[b]
    backdrop = colors.new_zeros(colors.shape[1]) if background is None else background
    backdrop = torch.cat([backdrop, colors.new_zeros(2)])
    pulls = _Pulls(screen, projection, b)
    if means2d.requires_grad:
        means2d.register_hook(pulls.add_signed)
    # One table, so that a block gathers, and its gradient scatters, once.
    table = torch.cat(
        [
            *(means2d, projection.conics[b], opacities[:, None]),
            *(colors, torch.ones_like(opacities)[:, None], depths[:, None]),
        ],
        dim=-1,
    )
    order = depths.argsort(stable=True)
    order = order[projection.visible[b][order]]
    low = (means2d - projection.extents[b]).detach()[order]
    high = (means2d + projection.extents[b]).detach()[order]

    rows = []
    for top in range(0, height, BLOCK):
        row = []
        for left in range(0, width, BLOCK):
            right, bottom = min(left + BLOCK, width), min(top + BLOCK, height)
            near = (low < low.new_tensor([right, bottom])).all(-1)
            near &= (high > high.new_tensor([left, top])).all(-1)
            x = torch.arange(left, right).to(means2d) + 0.5
            y = torch.arange(top, bottom).to(means2d) + 0.5
            pixels = torch.cartesian_prod(y, x).flip(-1)
            chosen = order[near]
            picture = _composite_pixels(pixels, table[chosen], backdrop, chosen, pulls)
            row.append(picture.unflatten(0, (bottom - top, right - left)))
        rows.append(torch.cat(row, dim=1))
    return torch.cat(rows, dim=0)


def _composite_pixels(
    pixels: Float[Tensor, "P 2"],
    table: Float[Tensor, "M columns"],
    backdrop: Float[Tensor, " channels"],
    chosen: Int[Tensor, " M"],
    pulls: "_Pulls",
) -> Float[Tensor, "P channels"]:
    means2d, conics, opacities, values = table.tensor_split([2, 5, 6], dim=-1)
    # One copy of the centre for each pixel: its gradient is that pixel's share.
    centres = means2d[:, None, :].expand(-1, len(pixels), -1).clone()
    if centres.requires_grad:
        centres.register_hook(lambda grad: pulls.add_absolute(chosen, grad))
    x, y = (pixels - centres).unbind(-1)
    xx, xy, yy = conics[:, None, :].unbind(-1)
    alpha = opacities * torch.exp(-0.5 * (xx * x * x + yy * y * y) - xy * x * y)
    alpha = alpha.clamp(max=MAX_ALPHA)
    alpha = torch.where(alpha >= MIN_ALPHA, alpha, 0)
    after = torch.cumprod(1 - alpha, dim=0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
    alive = after > MIN_TRANSMITTANCE  # once false it stays so: `after` never grows
    weights = torch.where(alive, alpha * before, 0)
    remaining = torch.where(alive, 1 - alpha, 1).prod(dim=0)
    return weights.T @ values + remaining[:, None] * backdrop


class _Pulls:
    """Collects one pose's screen statistics while autograd runs backwards through its blocks.

    The hooks of the blocks run before that of the projected centres, which needs all of them.
    """

    def __init__(self, screen: ScreenStatistics, projection: Projection, b: int) -> None:
        self._screen, self._b = screen, b
        self._grad = torch.zeros_like(projection.means2d)
        self._absgrad = torch.zeros_like(projection.means2d)

    def add_absolute(self, chosen: Tensor, grad: Float[Tensor, "M P 2"]) -> None:
        self._absgrad[self._b].index_add_(0, chosen, grad.abs().sum(1))

    def add_signed(self, grad: Float[Tensor, "N 2"]) -> None:
        self._grad[self._b] = grad
        self._screen.add(self._grad, self._absgrad)
        self._grad, self._absgrad = torch.zeros_like(self._grad), torch.zeros_like(self._grad)
