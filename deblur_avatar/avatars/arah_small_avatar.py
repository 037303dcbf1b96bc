"""ARAH's avatar, reduced: a signed distance field that forward skinning poses, drawn as a volume.

Rays find the surface first, and samples are placed where it is; each goes back to the canonical
pose by a search for the point that skinning moves to it. Gradients are those of the roots.

Conventions. Surface and colours see the pose at the frame's middle, as networks do elsewhere;
points are taken back at every instant. Canonical space, metres. P points, Q rays, K samples.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.avatar import part_on_disk
from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.arah_small_params import ArahSmallFitting, ArahSmallParams
from deblur_avatar.avatars.avatar import ParameterGroups, Regularisers, TrainingStep
from deblur_avatar.avatars.body_distance import (
    KnownDistances,
    distances_all_over,
    distances_near,
    outer_surface,
)
from deblur_avatar.avatars.forward_skinning import (
    BakedWeights,
    ForwardSkinning,
    attached,
    baked,
)
from deblur_avatar.avatars.frame_latents import FrameLatents
from deblur_avatar.avatars.gaussians import sample_surface
from deblur_avatar.avatars.networks import ConditionedMLP
from deblur_avatar.avatars.params import AvatarParams, FittingParams, Precision
from deblur_avatar.avatars.pose_encoder import PoseEncoder
from deblur_avatar.avatars.regularisers import skinning_distance
from deblur_avatar.avatars.sdf_field import Modulation, SdfField, density, eikonal
from deblur_avatar.avatars.skinning_field import SkinningField
from deblur_avatar.avatars.surface_search import (
    REACH,
    met_surface,
    near_body,
    placed_samples,
    sample_lengths,
)
from deblur_avatar.avatars.volumes import VolumeAvatar, VolumeRendering, VolumeState
from deblur_avatar.geometry.skinning import skin_points
from deblur_avatar.rendering.volume_rendering import Rays, composite, opacity, sample_depths

# Not parameters: enough for any body; how long and how strongly are.
KNOWN_POINTS = 8192  # whose distance from the body is known
POINTS = 1024  # of them, or on the surface, in a step: the release's
# Rates of Adam before fitting. With four times the second, distances end as 0 everywhere, in waves
# as steep as they should be.
SKINNING_RATE, SDF_RATE = 5e-3, 5e-4
POSE_NOISE_SHARE = 0.5  # of the steps have `pose_noise`: the release's
CULL = 1e-4  # opacity of samples that are left out
FAR, DEEP = 0.2, 0.03  # metres from the body where no surface is, and in it where all is inside
FAR_FALLOFF, DEEP_SLOPE = 100.0, 5000.0  # a metre: the release's


@dataclass(frozen=True)
class ArahState(VolumeState):
    """What one frame's surface and colours depend on, and what skins it."""

    latent: Float[Tensor, " Z"]
    modulation: Modulation
    grid: BakedWeights


class ArahSmallAvatar(VolumeAvatar):
    """A surface that depends on the pose, its colours, and the network that skins it.

    Source: ARAH, Wang et al., ECCV 2022 (docs/decisions/0045-arah-small.md says what is smaller
    here, and what differs).
    """

    kind = "arah_small"
    Params: ClassVar[type[AvatarParams]] = ArahSmallParams
    Fitting: ClassVar[type[FittingParams]] = ArahSmallFitting
    params: ArahSmallParams
    box: Tensor
    faces: Tensor

    def __init__(
        self, params: ArahSmallParams, body: Body, betas: Tensor, frames: int,
        averaging_space: str, generator: torch.Generator | None = None,
    ) -> None:  # fmt: skip
        super().__init__(params, body, betas, frames, averaging_space)
        self.register_buffer("faces", body.faces.to(betas.device), persistent=False)
        self.latents = FrameLatents(frames, params.sdf.latent)
        self.pose_encoder = PoseEncoder(body, betas)
        self.sdf = SdfField(
            self.canonical_vertices, self.pose_encoder.size + params.sdf.latent,
            params.sdf.hidden, params.sdf.frequency, generator,
        )  # fmt: skip
        self.log_width = nn.Parameter(betas.new_tensor(params.sdf.width_m).log())
        self.skinning_field = SkinningField(body.parents, params.skinning.hidden, params.precision)
        self.color_network = ConditionedMLP(
            3 + 3 + params.sdf.hidden[-1], params.sdf.latent, params.color.hidden, 3,
            params.precision,
        )  # fmt: skip
        self._grid: BakedWeights | None = None
        self._known: KnownDistances | None = None

    @classmethod
    def create(
        cls, params: Any, body: Body, betas: Tensor, frames: int, count: int, averaging_space: str,
        generator: torch.Generator,
    ) -> "ArahSmallAvatar":  # fmt: skip
        """A new avatar, whose surface is anywhere until `pretrain`; it has no Gaussians."""
        return cls(params, body, betas, frames, averaging_space, generator)

    @property
    def precision(self) -> Precision:
        """That of skinning and colours; distances are differentiated twice, in float32."""
        return self.params.precision

    def condition(
        self,
        rotations: Float[Tensor, "J 3 3"],
        frame: int,
        transforms: Float[Tensor, "J 4 4"],
        viewmat: Float[Tensor, "4 4"],
        step: TrainingStep | None = None,
    ) -> ArahState:
        """Encode the pose, but for how the body is turned, and modulate the surface by it."""
        latent = self.latents(frame)
        seen = torch.cat([torch.eye(3).to(rotations)[None], rotations[1:]])
        if step is not None and step.fitting.pose_noise > 0:
            chance = torch.rand(1, generator=step.generator).to(seen)
            draw = torch.randn(seen.shape, generator=step.generator).to(seen)
            seen = seen + draw * step.fitting.pose_noise * (chance < POSE_NOISE_SHARE)
        modulation = self.sdf.modulated(torch.cat([self.pose_encoder(seen), latent]))
        return ArahState(
            frame, None, transforms.detach(), step, latent, modulation, self.baked_weights()
        )

    def bounds(
        self, transforms: Float[Tensor, "J 4 4"]
    ) -> tuple[Float[Tensor, " 3"], Float[Tensor, " 3"]]:
        """The box of the posed body, and as far beyond as there can be a surface."""
        posed = skin_points(self.canonical_vertices, self.lbs_weights, transforms)
        return posed.amin(0) - REACH, posed.amax(0) + REACH

    def march(
        self,
        state: ArahState,
        transforms: Float[Tensor, "J 4 4"],
        rays: Rays,
        generator: torch.Generator | None,
    ) -> tuple[Float[Tensor, "Q 3"], Float[Tensor, " Q"]]:
        """Find the surface, place samples around it or, where there is none, all along the ray."""
        samples = self.params.samples
        light, alpha = transforms.new_zeros(len(rays), 3), transforms.new_zeros(len(rays))
        skinning = ForwardSkinning(
            state.grid, transforms, self.canonical_vertices, self.lbs_weights
        )
        near = near_body(rays, skinning, samples.free).nonzero()[:, 0]
        rays = rays.part(near)
        surface = met_surface(rays, skinning, lambda points: self.sdf(points, state.modulation)[0])
        for kind in (surface.met, ~surface.met):
            part, rows = rays.part(kind), near[kind]
            if kind is surface.met:
                depths = placed_samples(part, surface.depths[kind], samples, generator)
            else:
                depths = sample_depths(part.near, part.far, samples.free, generator)
            found = self._lit(state, transforms, skinning, part, depths)
            light, alpha = light.index_put((rows,), found[0]), alpha.index_put((rows,), found[1])
        return light, alpha

    def surface_colors(
        self, points: Float[Tensor, "P 3"], state: ArahState
    ) -> tuple[Float[Tensor, "P 3"], Float[Tensor, " P"]]:
        """Colours in the space in which light is averaged, and densities, per metre."""
        distances, features, normals = self.sdf.normals(points, state.modulation)
        seen = torch.cat([points, normals, features], dim=1)
        return self.color_network(seen, state.latent).sigmoid(), density(
            distances, self.log_width.exp()
        )

    def weights_at(self, points: Float[Tensor, "P 3"]) -> Float[Tensor, "P J"]:
        """Blend weights of canonical points."""
        return self.skinning_field((points - self.sdf.centre) / self.sdf.half_size)

    def baked_weights(self) -> BakedWeights:
        """The weights on a grid, as they were when last baked."""
        if self._grid is None or self._grid.low.dtype != self.betas.dtype:
            nodes = self.params.skinning.nodes
            self._grid = baked(self.weights_at, self.canonical_vertices, nodes)
        return self._grid

    def invalidate_neighbours(self) -> None:
        """Bake the weights anew, because they have moved."""
        self._grid = None

    def parameter_groups(self) -> ParameterGroups:
        """One group a part; the pose encoder's is the surface's."""
        parts = {
            "sdf": "sdf", "pose_encoder": "sdf", "color_network": "color", "log_width": "width",
            "latents": "latents", "skinning_field": "skinning",
        }  # fmt: skip
        groups: ParameterGroups = {group: [] for group in parts.values()}
        for name, value in self.named_parameters():
            groups[parts[name.partition(".")[0]]].append((part_on_disk(name), value))
        return groups

    def regularisers(self, rendering: VolumeRendering, step: TrainingStep) -> Regularisers:
        """Distances are distances, the surface is near the body, and is skinned as it is."""
        known = self._known_distances().some(POINTS, step.generator)
        found, _, gradients = self.sdf.normals(known.points, rendering.state.modulation)
        far, deep = known.distances > FAR, known.distances < -DEEP
        return {
            "eikonal": lambda: eikonal(gradients),
            "off_surface": lambda: _mean((-FAR_FALLOFF * found[far]).exp()),
            "inside": lambda: _mean((DEEP_SLOPE * found[deep]).sigmoid()),
            "skinning": lambda: self.skinning_error(POINTS, step.generator),
        }

    def skinning_error(self, samples: int, generator: torch.Generator) -> Float[Tensor, ""]:
        """How far blend weights on the body are from its own: sum over joints, mean over points."""
        found, wanted = self._weights_on_body(samples, generator)
        return (found - wanted).abs().sum(1).mean()

    def pretrain(self, generator: torch.Generator) -> None:
        """Teach skinning and surface those of the body, in place of the release's meta-learning."""
        skinning, sdf = self.params.skinning, self.params.sdf
        _descend(
            self.skinning_field.parameters(), SKINNING_RATE, skinning.pretrain,
            # Squared, which is learned at once; its absolute value is not.
            lambda: skinning_distance(*self._weights_on_body(POINTS, generator)),
        )  # fmt: skip
        vertices, faces = self.canonical_vertices, self.faces
        on_surface = outer_surface(vertices, faces, KNOWN_POINTS, generator)
        body = KnownDistances(on_surface, torch.zeros_like(on_surface[:, 0]))
        near = distances_near(vertices, faces, KNOWN_POINTS, generator)
        with torch.no_grad():  # all poses are alike yet
            still = self.sdf.modulated(torch.zeros(self.sdf.seen.in_features).to(vertices))

        def apart() -> Tensor:
            parts = [part.some(POINTS // 2, generator) for part in (body, near)]
            parts.append(self._known_distances().some(POINTS // 4, generator))
            places = torch.cat([part.points for part in parts])
            found, _, gradients = self.sdf.normals(places, still)
            wanted = torch.cat([part.distances for part in parts])
            return (found - wanted).abs().mean() + 0.1 * eikonal(gradients)

        self.invalidate_neighbours()
        own = [value for layer in self.sdf.layers for value in layer.parameters()]
        _descend(own, SDF_RATE, sdf.pretrain, apart)

    def fill_untrained_latents(self, trained: Sequence[int]) -> None:
        """Give each frame that was never trained the code of the nearest one that was."""
        self.latents.fill_untrained(trained)

    def _weights_on_body(
        self, samples: int, generator: torch.Generator
    ) -> tuple[Float[Tensor, "P J"], Float[Tensor, "P J"]]:
        """Blend weights of points on the body, and the body's own there."""
        points, chosen, corners = sample_surface(
            self.canonical_vertices, self.faces, samples, generator
        )
        wanted = (corners[..., None] * self.lbs_weights[self.faces[chosen]]).sum(1)
        return self.weights_at(points), wanted

    def _known_distances(self) -> KnownDistances:
        if self._known is None:
            self._known = distances_all_over(self.canonical_vertices, self.faces, KNOWN_POINTS)
        return self._known

    def _lit(
        self, state: ArahState, transforms: Tensor, skinning: ForwardSkinning, rays: Rays,
        depths: Float[Tensor, "Q K"],
    ) -> tuple[Float[Tensor, "Q 3"], Float[Tensor, " Q"]]:  # fmt: skip
        """Light and coverage from samples at depths; those that add nothing are left out."""
        lengths = sample_lengths(depths).flatten()
        with torch.no_grad():
            posed = rays.at(depths).flatten(0, 1)
            apart, vertices = skinning.nearest(posed)
            near = (apart < REACH).nonzero()[:, 0]
            points, found = skinning.canonical(posed[near], vertices[near])
            distances, _ = self.sdf(points, state.modulation)
            shown = opacity(density(distances, self.log_width.exp()), lengths[near])
            inverse, regular = skinning.inverse_jacobian(points)
            counts = found & regular & (shown > CULL)
            kept = near[counts]
        weights = self.weights_at(points[counts])
        places = attached(points[counts], inverse[counts], weights, transforms)
        colors, densities = self.surface_colors(places, state)
        opacities = lengths.new_zeros(len(lengths))
        opacities = opacities.index_put((kept,), opacity(densities, lengths[kept]))
        lights = lengths.new_zeros(len(lengths), 3).index_put((kept,), colors)
        return composite(opacities.reshape(depths.shape), lights.reshape(*depths.shape, 3))


def _descend(
    parameters: Iterable[nn.Parameter], rate: float, iterations: int, loss: Callable[[], Tensor]
) -> None:
    """Adam, whose rate falls to nothing."""
    optimizer = torch.optim.Adam(parameters, lr=rate)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(iterations, 1))
    for _ in range(iterations):
        optimizer.zero_grad()
        loss().backward()
        optimizer.step()
        decay.step()


def _mean(values: Float[Tensor, " P"]) -> Float[Tensor, ""]:
    """The mean of what may be nothing."""
    return values.sum() / max(len(values), 1)
