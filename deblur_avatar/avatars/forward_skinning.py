"""Forward skinning turned round: which canonical points the joints move to given posed ones.

Weights stand in canonical space, so that a posed point's are known once the point is. Roots are
searched with weights that were baked into a grid; the gradient is that of the weights themselves.

Conventions. World coordinates, metres. A grid is [C, N, N, N] round the canonical body: channels,
then nodes along z, y and x; outside of it the nearest face counts. P points, J joints, N nodes.

Source: SNARF (Chen et al., ICCV 2021) and ARAH (Wang et al., ECCV 2022), whose searches evaluate
the network at each step.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from scipy.spatial import cKDTree
from torch import Tensor

from deblur_avatar.avatars.weight_volume import node_positions, trilinear
from deblur_avatar.geometry.root_finding import Roots, broyden
from deblur_avatar.geometry.skinning import invert_rigid, skin_points, transform_points

# Not parameters: of the search, of which every picture is made alike.
ITERATIONS = 10
TOLERANCE = 1e-4  # metres
GIVEN_UP = 1e-3  # metres by which a root may miss
STARTS = 2  # bones of the nearest vertex, from which a search begins again that has failed
SMALLEST_VOLUME = 1e-2  # times, that a neighbourhood may shrink to: the inverse stays a number
MARGIN = 0.15  # metres, of the grid round the canonical body

WeightsAt = Callable[[Float[Tensor, "P 3"]], Float[Tensor, "P J"]]


@dataclass(frozen=True)
class BakedWeights:
    """Blend weights on a grid, and its box."""

    low: Float[Tensor, " 3"]
    high: Float[Tensor, " 3"]
    weights: Float[Tensor, "J N N N"]


@torch.no_grad()
def baked(weights_at: WeightsAt, vertices: Float[Tensor, "V 3"], nodes: int) -> BakedWeights:
    """Weights on so many nodes along each axis round the canonical body."""
    low, high = vertices.amin(0) - MARGIN, vertices.amax(0) + MARGIN
    places = node_positions((low + high) / 2, (high - low) / 2, [nodes] * 3)
    weights = weights_at(places.flatten(0, -2))
    return BakedWeights(low, high, weights.T.unflatten(1, places.shape[:3]).contiguous())


class ForwardSkinning:
    """The body at one instant: baked weights blended into one transform a node; no gradients."""

    def __init__(
        self,
        grid: BakedWeights,
        transforms: Float[Tensor, "J 4 4"],
        vertices: Float[Tensor, "V 3"],
        lbs_weights: Float[Tensor, "V J"],
    ) -> None:
        """Blend, and pose the body's vertices, from which searches begin.

        Args:
            grid: of weights.
            transforms: canonical to posed.
            vertices: canonical.
            lbs_weights: theirs.
        """
        self._grid, self._joints = grid, transforms.detach()
        rows = self._joints[:, :3].flatten(1)
        blended = grid.weights.flatten(1).T @ rows
        self._blended = blended.T.unflatten(1, grid.weights.shape[1:]).contiguous()
        self.posed = skin_points(vertices, lbs_weights, self._joints)
        self._vertices = vertices
        self._bones = lbs_weights.topk(STARTS, dim=1).indices
        self._tree = cKDTree(self.posed.cpu().numpy())

    def nearest(
        self, points: Float[Tensor, "P 3"]
    ) -> tuple[Float[Tensor, " P"], Int64[Tensor, " P"]]:
        """Distances from the nearest posed vertices, and which they are."""
        distance, index = self._tree.query(points.cpu().numpy())
        return (
            torch.as_tensor(distance).to(points),
            torch.as_tensor(index, device=points.device),
        )

    def transforms_at(self, points: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3 4"]:
        """Canonical to posed, where canonical points are."""
        middle = (self._grid.high + self._grid.low) / 2
        places = 2 * (points - middle) / (self._grid.high - self._grid.low)
        return trilinear(self._blended, places).unflatten(1, (3, 4))

    def skinned(self, points: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
        """Where canonical points are moved to."""
        return _moved(self.transforms_at(points), points)

    @torch.no_grad()
    def near_vertices(
        self, points: Float[Tensor, "P 3"], vertices: Int64[Tensor, " P"]
    ) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3 3"]]:
        """Posed points taken back as if glued to vertices, and the inverse that did it."""
        transforms = self.transforms_at(self._vertices[vertices])
        inverse = torch.linalg.inv_ex(transforms[..., :3])[0]
        return (inverse @ (points - transforms[..., 3])[..., None])[..., 0], inverse

    @torch.no_grad()
    def canonical(
        self, points: Float[Tensor, "P 3"], vertices: Int64[Tensor, " P"]
    ) -> tuple[Float[Tensor, "P 3"], Bool[Tensor, " P"]]:
        """Canonical points that are moved to posed ones, and which of them were found.

        Args:
            points: posed.
            vertices: nearest to them.
        """
        start, inverse = self.near_vertices(points, vertices)
        roots = self._search(points, start, inverse)
        for rank in range(STARTS):
            lost = (~(roots.residuals < GIVEN_UP)).nonzero()[:, 0]
            if not len(lost):
                break
            again = invert_rigid(self._joints)[self._bones[vertices[lost], rank]]
            start = transform_points(again, points[lost])
            found = self._search(points[lost], start, again[:, :3, :3].contiguous())
            better = Roots(roots.values[lost], roots.residuals[lost]).or_better(found)
            roots.values[lost], roots.residuals[lost] = better.values, better.residuals
        return roots.values, roots.residuals < GIVEN_UP

    def _search(self, points: Tensor, start: Tensor, inverse: Tensor) -> Roots:
        return broyden(
            lambda values, rows: self.skinned(values) - points[rows],
            start, inverse, ITERATIONS, TOLERANCE,
        )  # fmt: skip

    def inverse_jacobian(
        self, points: Float[Tensor, "P 3"]
    ) -> tuple[Float[Tensor, "P 3 3"], Bool[Tensor, " P"]]:
        """How canonical points follow posed ones, and where they do so at all."""
        with torch.enable_grad():
            places = points.detach().requires_grad_()
            moved = self.skinned(places)
            rows = [
                torch.autograd.grad(moved[:, axis].sum(), places, retain_graph=axis < 2)[0]
                for axis in range(3)
            ]
        jacobian = torch.stack(rows, dim=1)
        regular = torch.linalg.det(jacobian).abs() > SMALLEST_VOLUME
        still = torch.eye(3).to(jacobian).expand_as(jacobian)
        return torch.linalg.inv(torch.where(regular[:, None, None], jacobian, still)), regular


def attached(
    points: Float[Tensor, "P 3"],
    inverse_jacobian: Float[Tensor, "P 3 3"],
    weights: Float[Tensor, "P J"],
    transforms: Float[Tensor, "J 4 4"],
) -> Float[Tensor, "P 3"]:
    """The same canonical points, with the gradient of a root to what moves them.

    The posed point stays where it is, so that the canonical one gives way: dx = -J^-1 d skinned.

    Args:
        points: canonical, found without gradient.
        inverse_jacobian: of skinning there.
        weights: of the points, differentiable.
        transforms: canonical to posed, differentiable.
    """
    moved = skin_points(points, weights, transforms)
    return points - (inverse_jacobian @ (moved - moved.detach())[..., None])[..., 0]


def _moved(transforms: Tensor, points: Tensor) -> Float[Tensor, "P 3"]:
    return (transforms[..., :3] @ points[..., None])[..., 0] + transforms[..., 3]
