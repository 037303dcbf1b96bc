"""Gaussians on a mesh, one a face: they move, turn and stretch as their triangle does.

Conventions. A face abc is V's rows a, b, c; its *Steiner ellipse* is the ellipse through its
corners about its centroid, the circumcircle of an equilateral face. A Gaussian is a *shape* in the
frame whose axes are the ellipse's two and the face's normal times a thickness: of shape 1 its
standard deviations in the face are the ellipse's axes. Metres. S instants, V vertices, N faces.

Source: GoMAvatar (Wen et al., CVPR 2024).
"""

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.rendering.covariance_factors import covariances

FIRST_COLOR = 0.5
# Not parameters: of what float32 still knows of faces of a centimetre.
ROUND = 1e-4  # of a face's size; an ellipse this near to a circle has no longer axis
FLAT = 1e-12  # square metres; a face this small has no normal


class MeshGaussians(nn.Module):
    """The optimised parameters of a canonical mesh and of the Gaussians on its N faces."""

    def __init__(self, vertices: Float[Tensor, "V 3"], faces: int) -> None:
        """Start on a mesh, as large as its faces and grey.

        Args:
            vertices: canonical positions, metres.
            faces: N.
        """
        super().__init__()
        self.vertices = nn.Parameter(vertices.clone())
        self.turns = nn.Parameter(vertices.new_zeros(faces, 3))  # axis-angle, in the face's frame
        self.scales = nn.Parameter(vertices.new_ones(faces, 3))  # of its axes; the sign is nothing
        # In the space in which light is averaged, before shading; not bounded.
        self.colors = nn.Parameter(vertices.new_full((faces, 3), FIRST_COLOR))

    @property
    def shapes(self) -> Float[Tensor, "N 3 3"]:
        """Rotations times scales, in the faces' frames."""
        return axis_angle_to_matrix(self.turns) * self.scales[:, None, :]


def face_gaussians(
    vertices: Float[Tensor, "S V 3"],
    faces: Int64[Tensor, "N 3"],
    shapes: Float[Tensor, "N 3 3"],
    thickness: float,
) -> tuple[Float[Tensor, "S N 3"], Float[Tensor, "S N 6"]]:
    """Means and covariances (upper triangles) of the Gaussians on a posed mesh.

    Args:
        vertices: posed positions, metres.
        faces: triangles.
        shapes: rotations times scales in the faces' frames.
        thickness: standard deviation along the normal of a Gaussian of shape 1, metres.
    """
    corners = vertices[:, faces]
    factors = steiner_frames(corners, thickness) @ shapes
    covars = covariances(factors.flatten(0, 1)).unflatten(0, factors.shape[:2])
    return corners.mean(2), covars


def steiner_frames(
    corners: Float[Tensor, "*batch 3 3"], thickness: float
) -> Float[Tensor, "*batch 3 3"]:
    """Axes of the Steiner ellipse of triangles and their normals, as columns.

    An ellipse that is a circle to the precision has the axis through the last corner; a face
    without area has no normal: both without a gradient that is not a number.

    Args:
        corners: of each triangle, rows a, b, c; metres.
        thickness: length of the normals, metres.
    """
    a, b, c = corners.unbind(-2)
    towards = c - corners.mean(-2)  # conjugate half diameters of the ellipse
    along = (b - a) / 3**0.5
    twice = 2 * (towards * along).sum(-1)
    longer = towards.square().sum(-1) - along.square().sum(-1)
    size = towards.square().sum(-1) + along.square().sum(-1)
    round_ = twice.square() + longer.square() <= (ROUND * size).square()
    angle = torch.where(
        round_,
        torch.zeros_like(twice),
        torch.atan2(twice, torch.where(round_, torch.ones_like(longer), longer)) / 2,
    )[..., None]
    first = towards * angle.cos() + along * angle.sin()
    second = along * angle.cos() - towards * angle.sin()
    across = torch.linalg.cross(first, second)
    flat = across.square().sum(-1, keepdim=True) <= FLAT**2
    unit = torch.nn.functional.normalize(torch.where(flat, torch.ones_like(across), across), dim=-1)
    normal = thickness * torch.where(flat, torch.zeros_like(unit), unit)
    return torch.stack([first, second, normal], dim=-1)
