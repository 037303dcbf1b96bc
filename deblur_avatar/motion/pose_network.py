"""Pose network: a correction of poses that is a function of the pose alone, one for all frames.

Conventions. Those of `trajectory`. Root and translation stay as given.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.motion import Motion, named_in_code
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.config.section import Count, Params, Positive
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.motion.trajectory import Instants, MotionParams, Trajectory

# Not parameters: the published start, next to the given pose, and PyTorch's own slope.
LAST_WEIGHT = 1e-5  # largest of the last layer: turns of a thousandth of a degree
LEAKY_SLOPE = 0.01


class PoseNetworkParams(Params):
    """A pose network, in the section of a motion that has one."""

    hidden: tuple[Count, ...]
    rate: Positive  # learning rate


class PoseNetwork(nn.Module):
    """Turn every joint but the root by what all of them together ask for: R_j exp(r_j).

    Leaky where the published networks cut off at 0: a unit that is silent in all poses of one short
    clip would never learn.

    Source: HumanNeRF (Weng et al., CVPR 2022), pose correction, and its descendants GoMAvatar,
    GauHuman and MAD-Avatar, which differ in the hidden layers.
    """

    def __init__(self, joints: int, hidden: Sequence[int], generator: torch.Generator) -> None:
        """Start next to no correction.

        Args:
            joints: of the body, the root included.
            hidden: units of each hidden layer.
            generator: of the first weights.
        """
        super().__init__()
        seen = 3 * (joints - 1)
        self.layers = nn.ModuleList(nn.Linear(*sizes) for sizes in pairwise([seen, *hidden, seen]))
        for layer in self._linear():
            nn.init.xavier_uniform_(layer.weight, generator=generator)
            nn.init.zeros_(layer.bias)
        last = self._linear()[-1].weight
        nn.init.uniform_(last, -LAST_WEIGHT, LAST_WEIGHT, generator=generator)

    @classmethod
    def saved_in(cls, parameters: Mapping[str, Tensor], name: str) -> "PoseNetwork | None":
        """A network of the shape of one that was saved, not yet with its values.

        Args:
            parameters: of a saved motion.
            name: that the network has there.

        Returns:
            None if none was saved.
        """
        biases: list[int] = []  # their lengths, layer by layer
        while (key := f"{name}.layers.{len(biases)}.bias") in parameters:
            biases.append(len(parameters[key]))
        if not biases:
            return None
        return cls(biases[-1] // 3 + 1, biases[:-1], torch.Generator())

    def forward(self, quats: Float[Tensor, "*batch J 4"]) -> Float[Tensor, "*batch J 4"]:
        """Correct poses, each for itself."""
        root, others = quats[..., :1, :], quats[..., 1:, :]
        *hidden, last = self._linear()
        value = quat_to_axis_angle(others).flatten(-2)
        for layer in hidden:
            value = nn.functional.leaky_relu(layer(value), LEAKY_SLOPE)
        turns = axis_angle_to_quat(last(value).unflatten(-1, (-1, 3)))
        return torch.cat([root, quat_multiply(others, turns)], dim=-2)

    def _linear(self) -> list[nn.Linear]:
        return [layer for layer in self.layers if isinstance(layer, nn.Linear)]


class NetworkParams(MotionParams):
    """The given poses, corrected by one network for all frames."""

    kind: Literal["network"]
    pose_network: PoseNetworkParams

    def learning_rates(self) -> dict[str, float]:
        """That of the network."""
        return {"pose_network": self.pose_network.rate}


class NetworkMotion(Trajectory):
    """One pose a frame: the given one, corrected by a network that all frames share.

    It has far fewer ways to err than a free pose a frame, and cannot tell two frames apart that
    were given the same pose. Frames that were not fitted are corrected as the others are.

    Source: as of `PoseNetwork`, here with any avatar.
    """

    kind = "network"
    Params: ClassVar[type[MotionParams]] = NetworkParams
    knows_unfitted = True
    given: Tensor
    given_transl: Tensor

    def __init__(self, poses: Poses, pose_network: PoseNetwork) -> None:
        super().__init__()
        self.register_buffer("u", torch.tensor([0.5]), persistent=False)
        self.register_buffer("given", poses.axis_angle)
        self.register_buffer("given_transl", poses.transl.clone())
        self.pose_network = pose_network

    @classmethod
    def create(
        cls, observations: Observations, params: NetworkParams, generator: torch.Generator
    ) -> "NetworkMotion":
        """The given poses, next to uncorrected."""
        poses = observations.poses
        joints = poses.axis_angle.shape[1]
        return cls(poses, PoseNetwork(joints, params.pose_network.hidden, generator))

    @classmethod
    def from_artifact(cls, motion: Motion) -> "NetworkMotion":
        """Rebuild what was saved."""
        saved = named_in_code(motion.parameters)
        pose_network = PoseNetwork.saved_in(saved, "pose_network")
        assert pose_network is not None
        trajectory = cls(motion.centre, pose_network)
        # Copies values: fitting works in place, and an artifact never changes.
        trajectory.load_state_dict(saved)
        return trajectory

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """The frame's one pose, at every instant."""
        quats = self.pose_network(axis_angle_to_quat(self.given[frame]))
        transl = self.given_transl[frame]
        return Instants(quats.expand(len(u), -1, -1), transl.expand(len(u), -1), quats, transl)

    def parameter_groups(self) -> dict[str, list[tuple[str, Tensor]]]:
        """The network's weights."""
        return {"pose_network": named_weights(self.pose_network)}


def named_weights(pose_network: PoseNetwork | None) -> list[tuple[str, Tensor]]:
    """Weights of a motion's `pose_network` by their names in the motion; none without one."""
    named = () if pose_network is None else pose_network.named_parameters()
    return [(f"pose_network.{name}", value) for name, value in named]
