"""An avatar: canonical Gaussians that are frame_state once a frame and posed at every instant.

Conventions. *Dressing* is all that does not depend on the instant inside an exposure: non-rigid
offsets, blend weights, the square root of each covariance. *Posing* applies B sets of joint
transforms to it in one batch. World coordinates, metres. The canonical pose is Vitruvian.

Deblur-Avatar's text evaluates the non-rigid network at every virtual pose; as in its code, we do so
once a frame, at the middle.
"""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.appearance import ColorNetwork, random_view_rotation
from deblur_avatar.avatars.gaussians import Gaussians, gaussians_on_surface
from deblur_avatar.avatars.networks import ConditionedMLP, one_blob
from deblur_avatar.avatars.params import ModelParams, Precision
from deblur_avatar.avatars.pose_encoder import PoseEncoder
from deblur_avatar.avatars.skinning_field import SkinningField, surface_weights
from deblur_avatar.bodies.posed_body import (
    shaped_vertices,
    transforms_from_rotations,
    vitruvian_transforms,
)
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import Camera, camera_centres
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import (
    blend_transforms,
    invert_rigid,
    skin_points,
)
from deblur_avatar.imaging.color import linear_to_srgb
from deblur_avatar.rendering.covariance_factors import covariance_factors, covariances
from deblur_avatar.rendering.posing import pose_gaussians
from deblur_avatar.rendering.rasterize import rasterize

# What avatars say nothing of: they were saved before there was a choice. Equal avatars stay equal
# bytes.
PRECISION_OF_OLD: Precision = "bfloat16"

BOX_PADDING = 0.1  # of the canonical body's extent on each side (3DGS-Avatar)


@dataclass(frozen=True)
class FrameState:
    """One frame's canonical Gaussians, ready to be posed at any of its instants."""

    means: Float[Tensor, "N 3"]
    covariance_factors: Float[
        Tensor, "N 3 3"
    ]  # rotation times scales; the covariance is covariance_factors covariance_factors^T
    lbs_weights: Float[Tensor, "N J"]
    deformation: Float[Tensor, "N Z"]  # the non-rigid network's code, for the colours
    pose_code: Float[Tensor, " E"] | None
    frame: int

    def posed(
        self, transforms: Float[Tensor, "B J 4 4"]
    ) -> tuple[Float[Tensor, "B N 3"], Float[Tensor, "B N 6"]]:
        """Means and covariances (upper triangles) in B poses."""
        return pose_gaussians(self.means, self.covariance_factors, self.lbs_weights, transforms)


class AvatarModel(nn.Module):
    """Gaussians and the networks that deform, skin and colour them."""

    betas: Tensor
    box: Tensor
    canonical_vertices: Tensor
    rest_from_canonical: Tensor

    def __init__(
        self, params: ModelParams, gaussians: Gaussians, body: Body, betas: Tensor, frames: int,
        light: str,
    ) -> None:  # fmt: skip
        super().__init__()
        self.params, self.body, self.frames, self.light = params, body, frames, light
        self.gaussians = gaussians
        # The means that have been looked up on the body, and the weights found there.
        self._found: tuple[Tensor, Tensor] | None = None
        self.register_buffer("betas", betas, persistent=False)
        canonical = vitruvian_transforms(body, betas)
        weights = body.lbs_weights.to(betas)
        vertices = skin_points(shaped_vertices(body, betas), weights, canonical)
        low, high = vertices.amin(0), vertices.amax(0)
        padding = BOX_PADDING * (high - low)
        self.register_buffer("box", torch.stack([low - padding, high + padding]), persistent=False)
        self.register_buffer("canonical_vertices", vertices, persistent=False)
        self.register_buffer("rest_from_canonical", invert_rigid(canonical), persistent=False)
        codes = 0
        precision: Precision = params.precision or PRECISION_OF_OLD
        if params.nonrigid is not None:
            self.pose_encoder = PoseEncoder(body, betas)
            codes = params.nonrigid.codes
            encoded = 3 * params.nonrigid.bins
            outputs = 3 + 3 + 3 + codes
            self.nonrigid = ConditionedMLP(
                encoded, self.pose_encoder.size, params.nonrigid.hidden, outputs, precision
            )
        if params.skinning is not None:
            self.skinning = SkinningField(body.parents, params.skinning.hidden, precision)
        if params.color is not None:
            self.color = ColorNetwork(
                gaussians.features.shape[1], codes, params.color.latent, frames,
                params.color.hidden, precision,
            )  # fmt: skip

    @classmethod
    def create(
        cls, params: ModelParams, body: Body, betas: Tensor, frames: int, count: int, light: str,
        generator: torch.Generator,
    ) -> "AvatarModel":  # fmt: skip
        """A new avatar of `count` Gaussians on the canonical body's surface."""
        weights = body.lbs_weights.to(betas)
        vertices = skin_points(
            shaped_vertices(body, betas), weights, vitruvian_transforms(body, betas)
        )
        features = params.color.features if params.color is not None else 3
        faces = body.faces.to(betas.device)
        gaussians = gaussians_on_surface(vertices, faces, count, features, generator)
        return cls(params, gaussians, body, betas, frames, light)

    @classmethod
    def from_artifact(cls, avatar: Avatar, body: Body, device: torch.device) -> "AvatarModel":
        """Rebuild an avatar from what a stage saved.

        Raises:
            ConfigError: if the artifact's composition is not one this version knows.
            ArtifactError: if its networks are not those of the composition.
        """
        parts: dict[str, Any] = avatar.model
        params = _composition(parts["params"])
        # Clones: fitting works in place, and an artifact never changes.
        gaussians = Gaussians(
            avatar.means.clone(), avatar.quats.clone(), avatar.log_scales.clone(),
            avatar.opacity_logits.clone(), avatar.features.clone(),
        )  # fmt: skip
        model = cls(params, gaussians, body, avatar.betas, parts["frames"], parts["light"])
        wanted = {name for name in model.state_dict() if not name.startswith("gaussians.")}
        if wanted != avatar.networks.keys():
            odd = sorted(wanted ^ avatar.networks.keys())
            raise ArtifactError(f"avatar/1: networks do not fit model: {odd}; run `dvc repro`")
        model.load_state_dict(avatar.networks, strict=False)
        return model.to(device)

    def to_artifact(self, iteration: int) -> Avatar:
        """What a later stage, or another program, needs to draw this avatar."""
        self.invalidate_neighbours()
        # Clones: fitting works in place, and an artifact never changes.
        state = {name: value.cpu().clone() for name, value in self.state_dict().items()}
        own = "gaussians."
        gaussians = {k.removeprefix(own): v for k, v in state.items() if k.startswith(own)}
        return Avatar(
            **gaussians,
            betas=self.betas.cpu(),
            networks={k: v for k, v in state.items() if not k.startswith(own)},
            model={
                "params": _as_json(self.params),
                "frames": self.frames,
                "light": self.light,
            },
            iteration=iteration,
        )

    def condition(
        self,
        rotations: Float[Tensor, "J 3 3"],
        frame: int,
        *,
        deform: bool = True,
        pose_noise: Float[Tensor, "J 3 3"] | None = None,
    ) -> FrameState:
        """Evaluate everything that does not depend on the instant.

        Args:
            rotations: of the joints relative to their parents at the frame's centre; condition the
                networks (the root's is ignored: clothes do not know where the body stands).
            frame: training position, for the colour's latent code.
            deform: False before the non-rigid network is switched on.
            pose_noise: added to the conditioning rotations in training (3DGS-Avatar).
        """
        gaussians = self.gaussians
        means: Tensor = gaussians.means
        log_scales: Tensor = gaussians.log_scales
        turn = None
        code = None
        codes = self.params.nonrigid.codes if self.params.nonrigid is not None else 0
        deformation = means.new_zeros(len(means), codes)
        if self.params.nonrigid is not None:
            still = torch.eye(3).to(means)[None]
            conditions = torch.cat([still, rotations[1:]])
            code = self.pose_encoder(conditions if pose_noise is None else conditions + pose_noise)
            if deform:
                encoded = one_blob(self._boxed(means), self.params.nonrigid.bins)
                change = self.nonrigid(encoded, code)
                shift, stretch, turn, deformation = change.split([3, 3, 3, codes], dim=1)
                means, log_scales = means + shift, log_scales + stretch
        turned = covariance_factors(gaussians.quats, log_scales.exp(), turn)
        weights = self.weights_at(means)
        return FrameState(means, turned, weights, deformation, code, frame)

    def canonical_covariances(self) -> Float[Tensor, "N 6"]:
        """Covariances before any deformation."""
        gaussians = self.gaussians
        return covariances(covariance_factors(gaussians.quats, gaussians.scales))

    def weights_at(self, means: Float[Tensor, "N 3"]) -> Float[Tensor, "N J"]:
        """Blend weights where the non-rigid network has moved the Gaussians.

        Without a skinning network they are those of the body where each Gaussian was when it was
        last looked up.
        """
        if self.params.skinning is not None:
            return self.skinning(self._boxed(means) * 2 - 1)
        own = self.gaussians.means
        if self._found is None or self._found[0] is not own:
            self._found = own, surface_weights(own, self.canonical_vertices, self.body)
        return self._found[1]

    def invalidate_neighbours(self) -> None:
        """Forget where on the body the Gaussians were, because they have moved."""
        self._found = None

    def transforms(
        self,
        rotations: Float[Tensor, "*batch J 3 3"],
        transl: Float[Tensor, "*batch 3"],
    ) -> Float[Tensor, "*batch J 4 4"]:
        """Canonical-to-posed transforms of all joints."""
        posed = transforms_from_rotations(self.body, self.betas, rotations, transl)
        return posed @ self.rest_from_canonical

    def colors(
        self,
        frame_state: FrameState,
        transforms: Float[Tensor, "J 4 4"],
        viewmat: Float[Tensor, "4 4"],
        view_noise: Float[Tensor, "3 3"] | None = None,
    ) -> Float[Tensor, "N 3"]:
        """Colours seen from a camera, evaluated at one pose and shared by the frame's instants."""
        if self.params.color is None:
            return self.gaussians.features[:, :3].sigmoid()
        blended = blend_transforms(frame_state.lbs_weights, transforms).detach()
        posed = (blended[:, :3, :3] @ frame_state.means[..., None])[..., 0] + blended[:, :3, 3]
        directions = posed - camera_centres(viewmat)
        directions = (blended[:, :3, :3].mT @ directions[..., None])[..., 0]
        if view_noise is not None:
            directions = directions @ view_noise
        directions = nn.functional.normalize(directions, dim=-1)
        features = self.gaussians.features
        return self.color(features, directions, frame_state.deformation, frame_state.frame)

    def view_noise(self, generator: torch.Generator) -> Float[Tensor, "3 3"] | None:
        """A random turn of the view directions for one training step, if the model has any."""
        if self.params.color is None or self.params.color.view_noise_degrees == 0:
            return None
        return random_view_rotation(self.params.color.view_noise_degrees, generator, self.betas)

    def _boxed(self, points: Tensor) -> Tensor:
        return (points - self.box[0]) / (self.box[1] - self.box[0])


def render_avatar(
    model: AvatarModel,
    poses: Poses,
    camera: Camera,
    *,
    frame: int = -1,
    background: Float[Tensor, " 3"] | None = None,
    average: bool = False,
) -> tuple[Float[Tensor, "B H W 3"], Float[Tensor, "B H W"]]:
    """Draw an avatar in B poses, each frame_state for itself; no gradients.

    Args:
        model: whom to draw.
        poses: B of them; their shape numbers are ignored in favour of the avatar's.
        camera: who looks.
        frame: training position whose latent code colours are drawn with; -1 for the last.
        background: in the space in which the avatar's light is averaged; black if not given.
        average: draw the B poses as the instants of one exposure, frame_state for the middle one.

    Returns:
        sRGB images in [0, 1], and coverage; of one exposure if `average`.
    """
    device = model.betas.device
    camera = camera.to(device)
    frame = model.frames - 1 if frame < 0 else frame
    groups = [range(len(poses.transl))] if average else [[i] for i in range(len(poses.transl))]
    images, alphas = [], []
    with torch.no_grad():
        turned = axis_angle_to_matrix(poses.axis_angle).to(device)
        for group in groups:
            index = torch.tensor(list(group), device=device)
            rotations = turned[index]
            transforms = model.transforms(rotations, poses.transl.to(device)[index])
            middle = len(group) // 2
            frame_state = model.condition(rotations[middle], frame)
            colors = model.colors(frame_state, transforms[middle], camera.viewmat)
            means, covars = frame_state.posed(transforms)
            drawn = rasterize(
                means, covars, model.gaussians.opacities, colors, camera.viewmat, camera.K,
                camera.width, camera.height, background=background, average=average,
            )  # fmt: skip
            images.append(drawn.image)
            alphas.append(drawn.alpha)
    return encode(torch.cat(images), model.light), torch.cat(alphas)


def encode(image: Float[Tensor, "*batch H W 3"], light: str) -> Float[Tensor, "*batch H W 3"]:
    """Turn averaged light into sRGB values in [0, 1]."""
    return linear_to_srgb(image.clamp(0, 1)) if light == "linear" else image.clamp(0, 1)


def _as_json(params: ModelParams) -> dict[str, Any]:
    """The composition as it is saved, in which the precision of old goes without saying."""
    said = params.model_dump(mode="json")
    if params.precision in (None, PRECISION_OF_OLD):
        del said["precision"]
    return said


def _composition(said: Any) -> ModelParams:
    """The composition that `_as_json` saved.

    Raises:
        ConfigError: if it is not one this version knows.
    """
    if isinstance(said, dict) and any(value is not None for value in said.values()):
        said = {"precision": PRECISION_OF_OLD, **said}
    return parse(ModelParams, said, "avatar model")
