"""GART's avatar: Gaussians skinned by a weight volume and by latent bones.

Conventions. Harmonics are in each Gaussian's own frame, so that colours turn with it. Latent bones
depend on the pose once a frame, at its middle, as networks do elsewhere; with the root they turn at
every instant. J joints, B latent bones; weights have J + B + 1 columns, the last for translation.
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from deblur_avatar.artifacts.avatar import part_on_disk
from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.avatar import (
    ParameterGroups,
    Regularisers,
    TrainingStep,
    canonical_vertices,
)
from deblur_avatar.avatars.gart_params import GartFitting, GartParams
from deblur_avatar.avatars.gaussians import (
    Gaussians,
    face_areas,
    sample_surface,
)
from deblur_avatar.avatars.harmonic_colors import (
    constant_coefficients,
    degree_at,
    further_coefficients,
    harmonic_colors,
    harmonic_features,
    seen_from,
)
from deblur_avatar.avatars.knn_deviation import knn_deviation
from deblur_avatar.avatars.latent_bones import LatentBones, with_latent_bones
from deblur_avatar.avatars.params import AvatarParams, FittingParams, Precision
from deblur_avatar.avatars.splats import SplatAvatar, SplatRendering, SplatState
from deblur_avatar.avatars.surface_projection import vertex_normals
from deblur_avatar.avatars.weight_volume import WeightVolume, magnitude, total_variation
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.geometry.cameras import camera_centres
from deblur_avatar.geometry.rotations import matrix_to_quat, quat_to_matrix
from deblur_avatar.geometry.skinning import blend_transforms, transform_points
from deblur_avatar.rendering.covariance_factors import covariance_factors
from deblur_avatar.rendering.posing import pose_gaussians

# Not parameters: weights of the deviations are tuned to the one, and fitting leaves the others.
KNN = 5  # others in a neighbourhood: GART's six with the Gaussian itself
FIRST_OPACITY = 0.99
THICKNESS = 0.5  # of a Gaussian's radius on the surface, along the normal


@dataclass(frozen=True)
class GartState(SplatState):
    """One frame's Gaussians and its latent bones; `lbs_weights` have J + B + 1 columns."""

    latent_bones: Float[Tensor, "B 4 4"]
    root: Float[Tensor, " 3"]  # at rest

    def posed(
        self, transforms: Float[Tensor, "S J 4 4"]
    ) -> tuple[Float[Tensor, "S N 3"], Float[Tensor, "S N 6"]]:
        """Means and covariances (upper triangles) at S instants."""
        bones = with_latent_bones(transforms, self.latent_bones, self.root)
        return pose_gaussians(self.means, self.covariance_factors, self.lbs_weights, bones)


class GartAvatar(SplatAvatar):
    """Gaussians, the volume that skins them, and the network that moves latent bones.

    Source: GART, Lei et al., CVPR 2024 (docs/decisions/0038-gart.md says where this departs).
    """

    kind = "gart"
    Params: ClassVar[type[AvatarParams]] = GartParams
    Fitting: ClassVar[type[FittingParams]] = GartFitting
    beyond_a_rig: ClassVar[str] = (
        "whose weights do not sum to 1, whose latent bones a network moves and whose colours "
        "depend on the view, which no skeleton carries"
    )
    knn: ClassVar[int] = KNN
    params: GartParams
    root: Tensor

    def __init__(
        self, params: GartParams, gaussians: Gaussians, body: Body, betas: Tensor, frames: int,
        averaging_space: str,
    ) -> None:  # fmt: skip
        super().__init__(params, gaussians, body, betas, frames, averaging_space)
        self.register_buffer("root", shaped_joints(body, betas)[0], persistent=False)
        bones, volume = params.latent_bones, params.volume
        self.weight_volume = WeightVolume(
            self.canonical_vertices, body.lbs_weights.to(betas), volume.nodes, volume.smoothing,
            bones.count,
        )  # fmt: skip
        self.latent_bones = LatentBones(len(body.parents), bones.count, bones.hidden)

    @staticmethod
    def features(params: GartParams) -> int:
        """Coefficients of the harmonics."""
        return harmonic_features(params.harmonics)

    @classmethod
    def create(
        cls, params: Any, body: Body, betas: Tensor, frames: int, count: int, averaging_space: str,
        generator: torch.Generator,
    ) -> "GartAvatar":  # fmt: skip
        """A new avatar of `count` flat Gaussians that lie on the canonical body's surface."""
        gaussians = discs_on_surface(
            canonical_vertices(body, betas), body.faces.to(betas.device), count,
            cls.features(params), generator,
        )  # fmt: skip
        return cls(params, gaussians, body, betas, frames, averaging_space)

    @property
    def precision(self) -> Precision:
        """That of the latent bones' network."""
        return "float32"

    def condition(
        self,
        rotations: Float[Tensor, "J 3 3"],
        frame: int,
        transforms: Float[Tensor, "J 4 4"],
        viewmat: Float[Tensor, "4 4"],
        step: TrainingStep | None = None,
    ) -> GartState:
        """Look the weights up, move the latent bones, colour the Gaussians."""
        gaussians = self.gaussians
        weights = self.weights_at(gaussians.means)
        bones = self.latent_bones(rotations)
        if step is not None and not step.past(step.fitting.latent_bones.start):
            bones = bones.detach()
        blended = blend_transforms(weights, with_latent_bones(transforms[None], bones, self.root))
        colors = self.colors(blended[0], viewmat, step)
        factors = covariance_factors(gaussians.quats, gaussians.scales)
        return GartState(frame, None, gaussians.means, factors, weights, colors, bones, self.root)

    def colors(
        self,
        blended: Float[Tensor, "N 4 4"],
        viewmat: Float[Tensor, "4 4"],
        step: TrainingStep | None = None,
    ) -> Float[Tensor, "N 3"]:
        """Colours seen from a camera, each in its Gaussian's own posed frame.

        Args:
            blended: canonical to posed, of each Gaussian.
            viewmat: of the camera.
            step: of fitting, which begins with one colour from all sides.
        """
        gaussians = self.gaussians
        frames = blended[:, :3, :3] @ quat_to_matrix(gaussians.quats)
        posed = transform_points(blended, gaussians.means)
        directions = seen_from(frames, posed, camera_centres(viewmat))
        up_at = () if step is None else step.fitting.harmonics_up_at
        degree = degree_at(step, self.params.harmonics, up_at)
        return harmonic_colors(gaussians.features, directions, degree)

    def weights_at(self, means: Float[Tensor, "N 3"]) -> Float[Tensor, "N W"]:
        """Weights of joints and latent bones at the Gaussians, and 1 for the translation."""
        return torch.nn.functional.pad(self.weight_volume(means), (0, 1), value=1.0)

    def parameter_groups(self) -> ParameterGroups:
        """Those of the Gaussians, of both parts of the volume, and of the bones' network."""
        volume = self.weight_volume
        bones = [
            (part_on_disk(f"latent_bones.{name}"), value)
            for name, value in self.latent_bones.named_parameters()
        ]
        return super().parameter_groups() | {
            "corrections": [(part_on_disk("weight_volume.corrections"), volume.corrections)],
            "latent": [(part_on_disk("weight_volume.latent"), volume.latent)],
            "bones": bones,
        }

    def regularisers(self, rendering: SplatRendering, step: TrainingStep) -> Regularisers:
        """Gaussians take after their neighbours; the volume is smooth and small, scales small."""
        own, volume = self.gaussians, self.weight_volume

        def deviation(values: Tensor) -> Tensor:
            return knn_deviation(values, self.neighbours())

        return {
            "std_quats": lambda: deviation(own.quats),
            "std_scales": lambda: deviation(own.scales),
            "std_opacities": lambda: deviation(own.opacities[:, None]),
            "std_colors": lambda: deviation(constant_coefficients(own.features)),
            "std_harmonics": lambda: deviation(further_coefficients(own.features)),
            "tv_weights": lambda: total_variation(volume.corrections),
            "tv_latent": lambda: total_variation(volume.latent),
            "size_weights": lambda: magnitude(volume.corrections),
            "size_latent": lambda: magnitude(volume.latent),
            "size_scales": lambda: own.scales.amax(1).square().mean(),
        }


def discs_on_surface(
    vertices: Float[Tensor, "V 3"],
    faces: Int64[Tensor, "T 3"],
    count: int,
    features: int,
    generator: torch.Generator,
) -> Gaussians:
    """Spread flat Gaussians evenly over a mesh, each as large as its share of the surface.

    Args:
        vertices: canonical positions, metres.
        faces: triangles.
        count: how many.
        features: appearance numbers of each, zero at first.
        generator: of the random positions, and of the discs' turns about the normals.
    """
    areas = face_areas(vertices, faces)
    means, chosen, corners = sample_surface(vertices, faces, count, generator, areas)
    normals = (corners[..., None] * vertex_normals(vertices, faces)[faces[chosen]]).sum(1)
    z = torch.nn.functional.normalize(normals, dim=-1)
    draws = torch.randn(z.shape, generator=generator, dtype=z.dtype).to(z)
    x = torch.nn.functional.normalize(torch.linalg.cross(z, draws), dim=-1)
    quats = matrix_to_quat(torch.stack([x, torch.linalg.cross(z, x), z], dim=-1))
    radius = float((areas.sum() / 2 / (math.pi * count)).sqrt())
    log_scales = means.new_tensor([radius, radius, THICKNESS * radius]).log().repeat(count, 1)
    opacity = means.new_full((count,), FIRST_OPACITY).logit()
    return Gaussians(means, quats, log_scales, opacity, means.new_zeros(count, features))
