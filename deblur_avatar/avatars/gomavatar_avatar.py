"""GoMAvatar's avatar: Gaussians on the faces of the body's mesh, shaded by its normals.

Conventions. Vertices move with the pose by a network once a frame, at its middle, as networks do
elsewhere, and with the joints at every instant; so do the normals that shade. Light is what
Gaussians splat, times a shading around 1 in each pixel. S instants, V vertices, N faces, J joints.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.avatar import part_on_disk
from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.avatar import (
    AvatarModel,
    FrameState,
    ParameterGroups,
    Regularisers,
    Rendering,
    TrainingStep,
)
from deblur_avatar.avatars.frequency_encoding import frequency_encoding, hann_window
from deblur_avatar.avatars.gomavatar_params import GomavatarFitting, GomavatarParams
from deblur_avatar.avatars.mesh_gaussians import MeshGaussians, face_gaussians
from deblur_avatar.avatars.mesh_normals import posed_normals
from deblur_avatar.avatars.mesh_terms import (
    adjacent_faces,
    color_consistency,
    laplacian,
    mesh_edges,
    normal_consistency,
)
from deblur_avatar.avatars.params import AvatarParams, FittingParams, Precision
from deblur_avatar.avatars.relu_network import ReluNetwork
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.geometry.rotations import matrix_to_axis_angle
from deblur_avatar.geometry.skinning import skin_points
from deblur_avatar.imaging.exposure import mean_of_instants, over
from deblur_avatar.rendering.conventions import eps2d_of
from deblur_avatar.rendering.normal_maps import seen_normals
from deblur_avatar.rendering.rasterize import rasterize

# Not parameters: HumanNeRF's non-rigid network, which this one has as it is.
RE_ENTRY = 4  # hidden layer that sees the encoded vertex again
POSE_SHIFT = 1e-2  # added to the pose, so that the pose at rest is not nothing to the network


@dataclass(frozen=True)
class MeshState(FrameState):
    """One frame's mesh in the canonical pose, ready to be posed at any of its instants."""

    vertices: Float[Tensor, "V 3"]
    shapes: Float[Tensor, "N 3 3"]  # of the Gaussians, in the faces' frames


@dataclass(frozen=True)
class MeshRendering(Rendering):
    """Renders of a mesh, and where it was at the S instants."""

    vertices: Float[Tensor, "S V 3"]


class GomavatarAvatar(AvatarModel):
    """The body's mesh, a Gaussian a face, and the networks that shade it and move its vertices.

    Source: GoMAvatar, Wen et al., CVPR 2024 (docs/decisions/0039-gomavatar.md says where this
    departs).
    """

    kind = "gomavatar"
    Params: ClassVar[type[AvatarParams]] = GomavatarParams
    Fitting: ClassVar[type[FittingParams]] = GomavatarFitting
    beyond_a_rig: ClassVar[str] = (
        "whose vertices a network moves with the pose and whose pixels another one shades, which "
        "no skeleton carries"
    )
    params: GomavatarParams
    faces: Tensor
    lbs_weights: Tensor
    edges: Tensor
    face_pairs: Tensor

    def __init__(
        self, params: GomavatarParams, body: Body, betas: Tensor, frames: int,
        averaging_space: str, generator: torch.Generator | None = None,
    ) -> None:  # fmt: skip
        super().__init__(params, body, betas, frames, averaging_space)
        faces = body.faces.to(betas.device)
        known = {
            "faces": faces,
            "lbs_weights": body.lbs_weights.to(betas),
            "edges": mesh_edges(faces),
            "face_pairs": adjacent_faces(faces),
        }
        for name, value in known.items():
            self.register_buffer(name, value, persistent=False)
        self.mesh = MeshGaussians(self.canonical_vertices, len(faces))
        shading, offsets = params.shading, params.nonrigid
        self.shading = ReluNetwork(
            3 + 6 * shading.frequencies, 0, shading.hidden, 1, generator=generator
        )
        self.offsets = ReluNetwork(
            6 * offsets.frequencies, 3 * (len(body.parents) - 1), offsets.hidden, 3, RE_ENTRY,
            generator,
        )  # fmt: skip

    @classmethod
    def create(
        cls, params: Any, body: Body, betas: Tensor, frames: int, count: int, averaging_space: str,
        generator: torch.Generator,
    ) -> "GomavatarAvatar":  # fmt: skip
        """A new avatar on the body's mesh, whose faces say how many Gaussians it has."""
        return cls(params, body, betas, frames, averaging_space, generator)

    @property
    def precision(self) -> Precision:
        """That of both networks."""
        return "float32"

    def condition(
        self,
        rotations: Float[Tensor, "J 3 3"],
        frame: int,
        transforms: Float[Tensor, "J 4 4"],
        viewmat: Float[Tensor, "4 4"],
        step: TrainingStep | None = None,
    ) -> MeshState:
        """Move the canonical vertices with the pose, but for how the body is turned."""
        vertices = self.mesh.vertices
        opened = 1.0 if step is None else step.fitting.nonrigid.opened(step)
        if opened is not None:
            frequencies = self.params.nonrigid.frequencies
            encoded = frequency_encoding(vertices, frequencies, hann_window(opened, frequencies))
            pose = matrix_to_axis_angle(rotations[1:]).flatten() + POSE_SHIFT
            vertices = vertices + self.offsets(encoded, pose)
        return MeshState(frame, None, vertices, self.mesh.shapes)

    def render(
        self,
        state: MeshState,
        transforms: Float[Tensor, "S J 4 4"],
        camera: Camera,
        *,
        average: bool = False,
        background: Float[Tensor, " 3"] | None = None,
    ) -> MeshRendering:
        """Pose the mesh at all instants, splat its Gaussians, shade each instant's picture."""
        posed = skin_points(state.vertices, self.lbs_weights, transforms)
        means, covars = face_gaussians(posed, self.faces, state.shapes, self.params.thickness_m)
        drawn = rasterize(
            means, covars, means.new_ones(len(self.faces)), self.mesh.colors, camera.viewmat,
            camera.K, camera.width, camera.height, eps2d=eps2d_of(camera.binning),
        )  # fmt: skip
        image = drawn.image * self.shading_maps(posed, drawn.alpha, camera)[..., None]
        alpha = drawn.alpha
        if average:
            image, alpha = mean_of_instants(image)[None], mean_of_instants(alpha)[None]
        if background is not None:
            pictures = zip(image, alpha, strict=True)
            image = torch.stack([over(*one, background.expand_as(one[0])) for one in pictures])
        return MeshRendering(image, alpha, len(transforms), None, posed)

    def shading_maps(
        self, vertices: Float[Tensor, "S V 3"], alpha: Float[Tensor, "S H W"], camera: Camera
    ) -> Float[Tensor, "S H W"]:
        """What the light of each pixel is multiplied by at each instant: from 0 to 2.

        Where Gaussians reach beyond the mesh it is what the network says of a normal of no length.

        Args:
            vertices: posed, metres.
            alpha: coverage; pixels without any have no light to shade.
            camera: who looks.
        """
        normals = posed_normals(vertices, self.faces)
        met, seen = seen_normals(vertices, normals, self.faces, camera, alpha.detach() > 0)
        shades = self.shades(torch.cat([seen, seen.new_zeros(1, 3)]))
        return shades[-1].expand_as(alpha).index_put(met.nonzero(as_tuple=True), shades[:-1])

    def shades(self, normals: Float[Tensor, "P 3"]) -> Float[Tensor, " P"]:
        """Shading of surfaces by their normals in the camera's axes, unit or 0; in (0, 2)."""
        encoded = frequency_encoding(normals, self.params.shading.frequencies)
        return 2 * self.shading(torch.cat([normals, encoded], dim=1))[:, 0].sigmoid()

    def parameter_groups(self) -> ParameterGroups:
        """One group for each parameter of the mesh, and one a network."""
        groups: ParameterGroups = {
            name: [(part_on_disk(f"mesh.{name}"), value)]
            for name, value in self.mesh.named_parameters()
        }
        networks = {"shading": self.shading, "offsets": self.offsets}
        for part, group in (("shading", "shading"), ("offsets", "nonrigid")):
            groups[group] = [
                (part_on_disk(f"{part}.{name}"), value)
                for name, value in networks[part].named_parameters()
            ]
        return groups

    def regularisers(self, rendering: MeshRendering, step: TrainingStep) -> Regularisers:
        """The posed mesh is smooth, and neighbouring faces are coloured alike."""
        posed, faces, pairs = rendering.vertices, self.faces, self.face_pairs
        return {
            "laplacian": lambda: laplacian(posed, self.edges),
            "normal_consistency": lambda: normal_consistency(posed, faces, pairs),
            "color_consistency": lambda: color_consistency(self.mesh.colors, pairs),
        }
