"""HumanNeRF's avatar, reduced: a radiance field in the T-pose that a motion-weight volume skins.

Points on the rays are taken back to the T-pose by learned weights, which also say what is air, then
moved by a network that sees the pose, and there the field says what colour and how dense they are.

Conventions. The network sees the pose of the frame's middle, as networks do elsewhere; points are
taken back at every instant. T-pose, metres. P points, Q rays, J joints, N nodes an axis.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.avatar import part_on_disk
from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.avatar import ParameterGroups, TrainingStep
from deblur_avatar.avatars.frequency_encoding import frequency_encoding, hann_window
from deblur_avatar.avatars.humannerf_small_params import (
    HumannerfSmallFitting,
    HumannerfSmallParams,
)
from deblur_avatar.avatars.motion_weight_volume import MotionWeightVolume, taken_back
from deblur_avatar.avatars.networks import ConditionedMLP
from deblur_avatar.avatars.params import AvatarParams, FittingParams, Precision
from deblur_avatar.avatars.relu_network import GAIN, ReluNetwork
from deblur_avatar.avatars.volumes import VolumeAvatar, VolumeState
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.geometry.rotations import matrix_to_axis_angle
from deblur_avatar.geometry.skinning import invert_rigid, transform_points
from deblur_avatar.rendering.volume_rendering import Rays, composite, opacity, sample_depths

# Not parameters. Added to the pose, so that the pose at rest is not nothing to the network.
POSE_SHIFT = 1e-2
# What is less than this share body is left out, and a picture changes by less
# than a two-hundredth: a third of the points and of the time remains.
CULL = 1e-3
# A density of 0 would have no gradient, and whole fits of the release end empty: softplus instead.
DENSITY_SCALE = 10.0  # per metre
DENSITY_SHIFT = -1.0


@dataclass(frozen=True)
class HumannerfState(VolumeState):
    """What one frame's points are taken back with, and moved by."""

    weights: Float[Tensor, "J N N N"]  # of the motion-weight volume
    pose: Float[Tensor, " A"]  # that the non-rigid network sees
    opened: float | None  # its window; None while it waits


class HumannerfSmallAvatar(VolumeAvatar):
    """A radiance field, motion weights and non-rigid offsets.

    Source: HumanNeRF, Weng et al., CVPR 2022 (docs/decisions/0044-humannerf-small.md says what is
    smaller here, and what differs).
    """

    kind = "humannerf_small"
    Params: ClassVar[type[AvatarParams]] = HumannerfSmallParams
    Fitting: ClassVar[type[FittingParams]] = HumannerfSmallFitting
    params: HumannerfSmallParams
    joints: Tensor

    def __init__(
        self, params: HumannerfSmallParams, body: Body, betas: Tensor, frames: int,
        averaging_space: str, generator: torch.Generator | None = None,
    ) -> None:  # fmt: skip
        super().__init__(params, body, betas, frames, averaging_space)
        joints = shaped_joints(body, betas)
        self.register_buffer("joints", joints, persistent=False)
        self.motion_weights = MotionWeightVolume(
            joints, body.parents, body.joint_names, params.motion_weights, generator
        )
        self.field = ConditionedMLP(
            3 + 6 * params.field.frequencies, 0, params.field.hidden, 4, params.precision
        )
        for layer in (*self.field.layers, self.field.last):
            nn.init.xavier_uniform_(layer.weight, GAIN, generator=generator)
            nn.init.zeros_(layer.bias)
        self.offsets = ReluNetwork(
            6 * params.nonrigid.frequencies, 3 * (len(joints) - 1), params.nonrigid.hidden, 3,
            generator=generator,
        )  # fmt: skip

    @classmethod
    def create(
        cls, params: Any, body: Body, betas: Tensor, frames: int, count: int, averaging_space: str,
        generator: torch.Generator,
    ) -> "HumannerfSmallAvatar":  # fmt: skip
        """A new avatar: fog, denser where bones are; it is not made of Gaussians."""
        return cls(params, body, betas, frames, averaging_space, generator)

    @property
    def precision(self) -> Precision:
        """That of the radiance field."""
        return self.params.precision

    def condition(
        self,
        rotations: Float[Tensor, "J 3 3"],
        frame: int,
        transforms: Float[Tensor, "J 4 4"],
        viewmat: Float[Tensor, "4 4"],
        step: TrainingStep | None = None,
    ) -> HumannerfState:
        """Make the weights, and say what the non-rigid network sees of the pose."""
        pose = matrix_to_axis_angle(rotations[1:]).flatten() + POSE_SHIFT
        opened = 1.0 if step is None else step.fitting.nonrigid.opened(step)
        return HumannerfState(
            frame, None, transforms.detach(), step, self.motion_weights(), pose, opened
        )

    def bounds(
        self, transforms: Float[Tensor, "J 4 4"]
    ) -> tuple[Float[Tensor, " 3"], Float[Tensor, " 3"]]:
        """The box of the posed joints, with a margin."""
        posed = transforms @ invert_rigid(self.rest_from_canonical)
        joints = transform_points(posed, self.joints)
        margin = self.params.motion_weights.margin_m
        return joints.amin(0) - margin, joints.amax(0) + margin

    def march(
        self,
        state: HumannerfState,
        transforms: Float[Tensor, "J 4 4"],
        rays: Rays,
        generator: torch.Generator | None,
    ) -> tuple[Float[Tensor, "Q 3"], Float[Tensor, " Q"]]:
        """Follow rays through the field; what is air is only looked at."""
        count = self.params.samples
        depths = sample_depths(rays.near, rays.far, count, generator)
        points = rays.at(depths).flatten(0, 1)
        rest_from_posed = self.rest_from_canonical @ invert_rigid(transforms)
        with torch.no_grad():
            weights = self.motion_weights.weights_at(state.weights, points, rest_from_posed)
            kept = (weights.sum(0) > CULL).nonzero()[:, 0]
        points = points[kept]
        weights = self.motion_weights.weights_at(state.weights, points, rest_from_posed)
        share, places = taken_back(weights, points, rest_from_posed)
        colors, densities = self.radiance(self.moved(places, state))
        lengths = (rays.far - rays.near) / count
        # Joints look in different places, so that together they can find more than all there is.
        found = share.clamp(max=1) * opacity(densities, lengths[kept // count])
        opacities = found.new_zeros(depths.numel()).index_put((kept,), found)
        shown = found.new_zeros(depths.numel(), 3).index_put((kept,), colors)
        return composite(opacities.unflatten(0, (-1, count)), shown.unflatten(0, (-1, count)))

    def moved(self, places: Float[Tensor, "P 3"], state: HumannerfState) -> Float[Tensor, "P 3"]:
        """Points of the T-pose where the non-rigid network moves them in a pose."""
        if state.opened is None:
            return places
        frequencies = self.params.nonrigid.frequencies
        window = hann_window(state.opened, frequencies)
        encoded = frequency_encoding(places, frequencies, window)
        return places + self.offsets(encoded, state.pose)

    def radiance(
        self, places: Float[Tensor, "P 3"]
    ) -> tuple[Float[Tensor, "P 3"], Float[Tensor, " P"]]:
        """Colours in the space in which light is averaged, and densities, per metre."""
        encoded = frequency_encoding(places, self.params.field.frequencies)
        raw = self.field(torch.cat([places, encoded], dim=1))
        densities = DENSITY_SCALE * nn.functional.softplus(raw[:, 3] + DENSITY_SHIFT)
        return raw[:, :3].sigmoid(), densities

    def parameter_groups(self) -> ParameterGroups:
        """One group a part."""
        parts = {"field": "field", "motion_weights": "motion_weights", "offsets": "nonrigid"}
        groups: ParameterGroups = {group: [] for group in parts.values()}
        for name, value in self.named_parameters():
            groups[parts[name.partition(".")[0]]].append((part_on_disk(name), value))
        return groups
