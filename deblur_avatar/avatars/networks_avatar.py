"""3DGS-Avatar's: Gaussians whose shape, skinning and colour networks have learned.

Deblur-Avatar's text evaluates the non-rigid network at every virtual pose; as in its code, we do so
once a frame, at the middle. Conventions. Networks see positions in a box around the canonical body,
[0, 1] along each axis.
"""

from collections.abc import Sequence
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.avatar import part_on_disk
from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.appearance import ColorNetwork, random_view_rotation
from deblur_avatar.avatars.avatar import ParameterGroups, Regularisers, TrainingStep
from deblur_avatar.avatars.gaussians import Gaussians, face_areas, sample_surface
from deblur_avatar.avatars.isometry import isometry
from deblur_avatar.avatars.networks import ConditionedMLP, one_blob
from deblur_avatar.avatars.networks_params import NetworksFitting, NetworksParams
from deblur_avatar.avatars.params import AvatarParams, FittingParams, Precision
from deblur_avatar.avatars.pose_encoder import PoseEncoder
from deblur_avatar.avatars.regularisers import skinning_distance
from deblur_avatar.avatars.skinning_field import SkinningField
from deblur_avatar.avatars.splats import SplatAvatar, SplatRendering, SplatState
from deblur_avatar.geometry.cameras import camera_centres
from deblur_avatar.geometry.skinning import blend_transforms
from deblur_avatar.rendering.covariance_factors import covariance_factors

# Not parameters: networks that were fitted in one box are wrong in another.
BOX_PADDING = 0.1  # of the canonical body's extent on each side (3DGS-Avatar)
COLORS = 3  # features without a colour network: raw colours
# Not parameters: enough for any body; how long and how strongly are `pretrain`, `early`, `late`.
SKINNING_SAMPLES = 1024  # points on the body a step (3DGS-Avatar)
PRETRAIN_SAMPLES = 4096  # points on the body a step
PRETRAIN_RATE = 2e-3  # of Adam
POSE_NOISE_SHARE = 0.5  # of the steps have `pose_noise` (3DGS-Avatar), which can be 0


class NetworksAvatar(SplatAvatar):
    """Gaussians and the networks that deform, skin and colour them.

    Source: 3DGS-Avatar, Qian et al., CVPR 2024.
    """

    kind = "networks"
    Params: ClassVar[type[AvatarParams]] = NetworksParams
    Fitting: ClassVar[type[FittingParams]] = NetworksFitting
    params: NetworksParams
    box: Tensor
    _faces: Tensor
    _areas: Tensor
    _lbs_weights: Tensor

    def __init__(
        self, params: NetworksParams, gaussians: Gaussians, body: Body, betas: Tensor, frames: int,
        averaging_space: str,
    ) -> None:  # fmt: skip
        super().__init__(params, gaussians, body, betas, frames, averaging_space)
        vertices = self.canonical_vertices
        low, high = vertices.amin(0), vertices.amax(0)
        padding = BOX_PADDING * (high - low)
        self.register_buffer("box", torch.stack([low - padding, high + padding]), persistent=False)
        codes = 0
        if params.nonrigid is not None:
            self.pose_encoder = PoseEncoder(body, betas)
            codes = params.nonrigid.codes
            self.deformation = ConditionedMLP(
                3 * params.nonrigid.bins, self.pose_encoder.size, params.nonrigid.hidden,
                3 + 3 + 3 + codes, params.precision,
            )  # fmt: skip
        if params.skinning is not None:
            self.skinning_field = SkinningField(
                body.parents, params.skinning.hidden, params.precision
            )
            # What the field is compared with, on the device of all else.
            faces = body.faces.to(betas.device)
            self.register_buffer("_faces", faces, persistent=False)
            self.register_buffer("_areas", face_areas(vertices, faces), persistent=False)
            body_weights = body.lbs_weights.to(betas.device)
            self.register_buffer("_lbs_weights", body_weights, persistent=False)
        if params.color is not None:
            self.color_network = ColorNetwork(
                gaussians.features.shape[1], codes, params.color.latent, frames,
                params.color.hidden, params.precision,
            )  # fmt: skip

    @staticmethod
    def features(params: NetworksParams) -> int:
        """What the colour network sees of a Gaussian, or raw colours."""
        return COLORS if params.color is None else params.color.features

    @property
    def precision(self) -> Precision:
        """That of its networks."""
        return self.params.precision

    @property
    def pose_code_size(self) -> int:
        """Length of the pose encoder's code."""
        return 0 if self.params.nonrigid is None else self.pose_encoder.size

    def condition(
        self,
        rotations: Float[Tensor, "J 3 3"],
        frame: int,
        transforms: Float[Tensor, "J 4 4"],
        viewmat: Float[Tensor, "4 4"],
        step: TrainingStep | None = None,
    ) -> SplatState:
        """Deform, skin and colour the Gaussians for one frame.

        The root's rotation is ignored: clothes do not know where the body stands. In training
        there is noise on the rotations and on the view.
        """
        gaussians = self.gaussians
        means: Tensor = gaussians.means
        log_scales: Tensor = gaussians.log_scales
        turn = code = None
        codes = self.params.nonrigid.codes if self.params.nonrigid is not None else 0
        deformation = means.new_zeros(len(means), codes)
        if self.params.nonrigid is not None:
            code = self.pose_code(rotations, step)
            if step is None or step.past(step.fitting.nonrigid.start):
                encoded = one_blob(self._boxed(means), self.params.nonrigid.bins)
                change = self.deformation(encoded, code)
                shift, stretch, turn, deformation = change.split([3, 3, 3, codes], dim=1)
                means, log_scales = means + shift, log_scales + stretch
        factors = covariance_factors(gaussians.quats, log_scales.exp(), turn)
        weights = self.weights_at(means)
        noise = None if step is None else self._view_noise(step.generator)
        colors = self.colors(means, weights, transforms, deformation, viewmat, frame, noise)
        return SplatState(frame, code, means, factors, weights, colors)

    def pose_code(
        self, rotations: Float[Tensor, "J 3 3"], step: TrainingStep | None = None
    ) -> Float[Tensor, " E"]:
        """Encode the pose that clothes depend on, in training with 3DGS-Avatar's noise."""
        still = torch.eye(3).to(rotations)[None]
        conditions = torch.cat([still, rotations[1:]])
        std = 0.0 if step is None else step.fitting.nonrigid.pose_noise
        if step is not None and std > 0:
            chance = torch.rand(1, generator=step.generator).to(rotations)
            draw = torch.randn(rotations.shape, generator=step.generator).to(rotations)
            conditions = conditions + draw * std * (chance < POSE_NOISE_SHARE)
        return self.pose_encoder(conditions)

    def colors(
        self,
        means: Float[Tensor, "N 3"],
        lbs_weights: Float[Tensor, "N J"],
        transforms: Float[Tensor, "J 4 4"],
        deformation: Float[Tensor, "N Z"],
        viewmat: Float[Tensor, "4 4"],
        frame: int,
        view_noise: Float[Tensor, "3 3"] | None = None,
    ) -> Float[Tensor, "N 3"]:
        """Colours seen from a camera, evaluated at one pose and shared by the frame's instants.

        Args:
            means: canonical, deformed.
            lbs_weights: blend weights.
            transforms: canonical to posed; no gradient flows back to the pose.
            deformation: the non-rigid network's code.
            viewmat: of the camera.
            frame: training position, for the latent code.
            view_noise: a random turn of the view directions.
        """
        features = self.gaussians.features
        if self.params.color is None:
            return features[:, :COLORS].sigmoid()
        blended = blend_transforms(lbs_weights, transforms).detach()
        posed = (blended[:, :3, :3] @ means[..., None])[..., 0] + blended[:, :3, 3]
        directions = posed - camera_centres(viewmat)
        directions = (blended[:, :3, :3].mT @ directions[..., None])[..., 0]
        if view_noise is not None:
            directions = directions @ view_noise
        directions = nn.functional.normalize(directions, dim=-1)
        return self.color_network(features, directions, deformation, frame)

    def weights_at(self, means: Float[Tensor, "N 3"]) -> Float[Tensor, "N J"]:
        """Blend weights where the non-rigid network has moved the Gaussians."""
        if self.params.skinning is None:
            return super().weights_at(means)
        return self.skinning_field(self._boxed(means) * 2 - 1)

    def parameter_groups(self) -> ParameterGroups:
        """Those of the Gaussians, of each network, and the frames' latent codes."""
        groups = super().parameter_groups()
        parts = {
            "skinning_field": "skinning",
            "deformation": "nonrigid",
            "pose_encoder": "nonrigid",
            "color_network": "color",
        }
        for part, group in parts.items():
            for name, value in self.named_parameters():
                if name.startswith(f"{part}."):
                    latents = name == "color_network.latents.weight"
                    named = groups.setdefault("latents" if latents else group, [])
                    named.append((part_on_disk(name), value))
        return groups

    def regularisers(self, rendering: SplatRendering, step: TrainingStep) -> Regularisers:
        """Blend weights near the body's, and neighbours that keep their distances in a pose."""
        middle = rendering.instants // 2

        def means() -> Tensor:
            return isometry(self.gaussians.means, rendering.means[middle], self.neighbours())

        def covars() -> Tensor:
            posed = rendering.covars[middle]
            return isometry(self.canonical_covariances(), posed, self.neighbours())

        terms = {"isometry_means": means, "isometry_covars": covars}
        if self.params.skinning is None:
            return terms
        return {
            "skinning": lambda: self.skinning_distance(SKINNING_SAMPLES, step.generator),
            **terms,
        }

    def skinning_distance(self, samples: int, generator: torch.Generator) -> Float[Tensor, ""]:
        """How far the blend weights are from the body's at so many points on its surface."""
        points, chosen, corners = sample_surface(
            self.canonical_vertices, self._faces, samples, generator, self._areas
        )
        wanted = (corners[..., None] * self._lbs_weights[self._faces[chosen]]).sum(1)
        return skinning_distance(self.weights_at(points), wanted)

    def pretrain(self, generator: torch.Generator) -> None:
        """Teach the skinning network the body's own weights before it has to bend anything.

        In the paper's 3,000 steps of warm-up it learns them on the way; a short schedule cannot
        wait for that.
        """
        if self.params.skinning is None:
            return
        iterations = self.params.skinning.pretrain
        optimizer = torch.optim.Adam(self.skinning_field.parameters(), lr=PRETRAIN_RATE)
        decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(iterations, 1))
        for _ in range(iterations):
            optimizer.zero_grad()
            self.skinning_distance(PRETRAIN_SAMPLES, generator).backward()
            optimizer.step()
            decay.step()

    def fill_untrained_latents(self, trained: Sequence[int]) -> None:
        """Give each frame that was never trained the colour code of the nearest one that was."""
        if self.params.color is not None:
            self.color_network.fill_untrained_latents(trained)

    def _view_noise(self, generator: torch.Generator) -> Float[Tensor, "3 3"] | None:
        """A random turn of the view directions for one training step, if there is any."""
        if self.params.color is None or self.params.color.view_noise_degrees == 0:
            return None
        return random_view_rotation(self.params.color.view_noise_degrees, generator, self.betas)

    def _boxed(self, points: Tensor) -> Tensor:
        return (points - self.box[0]) / (self.box[1] - self.box[0])
