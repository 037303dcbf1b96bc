"""Gaussians on a mesh, one a face: they move, turn and stretch as their triangle does.

Conventions. A face abc is V's rows a, b, c; its *Steiner ellipse* is the ellipse through its
corners about its centroid, the circumcircle of an equilateral face. A Gaussian is a *shape* in the
frame whose axes are the ellipse's two and the face's normal times a thickness: of shape 1 its
standard deviations in the face are the ellipse's axes. Metres. S instants, V vertices, N faces.

Float32 tensors on the CPU go through the native kernel of `triangle_mesh`.

Source: GoMAvatar (Wen et al., CVPR 2024).
"""

import ctypes
from typing import Any

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from deblur_avatar.avatars.triangle_mesh import FLAT, ROUND, corner_lists, mesh_library
from deblur_avatar.geometry.rotations import axis_angle_to_quat
from deblur_avatar.rendering.covariance_factors import covariance_factors, covariances_reference
from deblur_avatar.rendering.native_build import pointers
from deblur_avatar.run import kernel_threads

FIRST_COLOR = 0.5


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
        return covariance_factors(axis_angle_to_quat(self.turns), self.scales)


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
    library = mesh_library(vertices, shapes)
    if library is None:
        return face_gaussians_reference(vertices, faces, shapes, thickness)
    return _FaceGaussians.apply(vertices, shapes, faces, thickness, library)


def face_gaussians_reference(
    vertices: Float[Tensor, "S V 3"],
    faces: Int64[Tensor, "N 3"],
    shapes: Float[Tensor, "N 3 3"],
    thickness: float,
) -> tuple[Float[Tensor, "S N 3"], Float[Tensor, "S N 6"]]:
    """The same in plain torch, on any device and in any precision: the kernel's slow twin."""
    corners = vertices[:, faces]
    return corners.mean(2), covariances_reference(steiner_frames(corners, thickness) @ shapes)


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


class _FaceGaussians(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, vertices: Tensor, shapes: Tensor, faces: Tensor, thickness: float,
        library: ctypes.CDLL,
    ) -> tuple[Tensor, Tensor]:  # fmt: skip
        inputs = vertices.contiguous(), faces.contiguous(), shapes.contiguous()
        instants, count, faces_count = *vertices.shape[:2], len(faces)
        ctx.sizes = instants, count, faces_count, kernel_threads(), thickness
        ctx.lists, ctx.library = corner_lists(faces, count), library
        means = vertices.new_empty(instants, faces_count, 3)
        covars = vertices.new_empty(instants, faces_count, 6)
        library.face_gaussians(*ctx.sizes, *pointers(*inputs, means, covars))
        ctx.save_for_backward(*inputs)
        return means, covars

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, means_grad: Tensor, covars_grad: Tensor) -> tuple[Tensor | None, ...]:
        vertices, faces, shapes = ctx.saved_tensors
        upstream = means_grad.contiguous(), covars_grad.contiguous()
        corners = vertices.new_empty(len(vertices), len(faces), 9)
        found = torch.empty_like(vertices)
        shapes_grad = torch.empty_like(shapes) if ctx.needs_input_grad[1] else None
        ctx.library.face_gaussians_backward(
            *ctx.sizes, *pointers(vertices, faces, shapes, *upstream, *ctx.lists),
            *pointers(corners, found, shapes_grad),
        )  # fmt: skip
        return found, shapes_grad, None, None, None
