"""Normal maps: which way the surface of a mesh faces in each pixel of a camera.

Conventions. Cameras as in `geometry.cameras`; pixels are whole numbers (column, row), seen through
their middles. Normals are those of the vertices, interpolated. What a ray meets is looked up
without gradient; normals have one. P vertices, T triangles, Q pixels.
"""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from deblur_avatar.geometry.cameras import Camera, pixel_rays
from deblur_avatar.rendering.mesh_rendering import cast_rays

PIXEL_MIDDLE = 0.5


def seen_normals(
    vertices: Float[Tensor, "P 3"],
    normals: Float[Tensor, "P 3"],
    faces: Int64[Tensor, "T 3"],
    camera: Camera,
    pixels: Int64[Tensor, "Q 2"],
) -> tuple[Bool[Tensor, " Q"], Float[Tensor, "met 3"]]:
    """Which pixels show a mesh, and the unit normals that these see, in the camera's axes.

    Args:
        vertices: world positions, metres; no gradient flows to them.
        normals: of the vertices, unit, in the world; differentiable.
        faces: triangles.
        camera: who looks.
        pixels: that are asked for.
    """
    if not len(pixels):
        return pixels.new_zeros(0, dtype=torch.bool), normals.new_zeros(0, 3)
    middles = pixels.to(camera.K) + PIXEL_MIDDLE
    origins, directions = pixel_rays(camera.K, camera.viewmat, middles)
    hits = cast_rays(
        vertices.detach().cpu().numpy(), faces.cpu().numpy(), origins[0].cpu().numpy(),
        directions.cpu().numpy(),
    )  # fmt: skip
    met = torch.as_tensor(hits.triangle >= 0)
    u, v = (torch.as_tensor(value)[met].to(normals) for value in (hits.u, hits.v))
    corners = normals[faces[torch.as_tensor(hits.triangle)[met].long().to(faces.device)]]
    seen = (torch.stack([1 - u - v, u, v], dim=1)[..., None] * corners).sum(1)
    turned = torch.nn.functional.normalize(seen, dim=-1) @ camera.viewmat[:3, :3].T.to(normals)
    return met.to(normals.device), turned
