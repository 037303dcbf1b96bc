"""Pictures of an avatar in given poses, without gradients."""

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.imaging.exposure import decode, encode, over


def render_avatar(
    model: AvatarModel,
    poses: Poses,
    camera: Camera,
    *,
    frame: int = -1,
    background: Float[Tensor, " 3"] | None = None,
    average: bool = False,
) -> tuple[Float[Tensor, "B H W 3"], Float[Tensor, "B H W"]]:
    """Draw an avatar in B poses, each conditioned for itself.

    Args:
        model: the avatar to render.
        poses: B of them; their shape numbers are ignored in favour of the avatar's.
        camera: who looks.
        frame: training position whose latent code colours are made with; -1 for the last.
        background: in the space in which the avatar's light is averaged; black if not given.
        average: render the B poses as the instants of one exposure, conditioned for the middle one.

    Returns:
        sRGB images in [0, 1], and coverage; of one exposure if `average`.
    """
    device = model.betas.device
    camera = camera.to(device)
    frame = model.frames - 1 if frame < 0 else frame
    groups = [range(len(poses.transl))] if average else [[i] for i in range(len(poses.transl))]
    rendered = []
    with torch.no_grad():
        turned = axis_angle_to_matrix(poses.axis_angle)
        for group in groups:
            index = torch.tensor(list(group))
            rotations = turned[index]
            transforms = model.transforms(rotations, poses.transl[index])
            middle = len(group) // 2
            state = model.condition(
                rotations[middle].to(device), frame, transforms[middle], camera.viewmat
            )
            rendered.append(
                model.render(state, transforms, camera, average=average, background=background)
            )
    image = torch.cat([one.image for one in rendered])
    return encode(image, model.averaging_space), torch.cat([one.alpha for one in rendered])


def light_behind(
    observations: Observations, position: int, device: torch.device
) -> Float[Tensor, "H W 3"] | None:
    """What is behind the person in one frame, in the space in which light is averaged."""
    picture = observations.background(position)
    if picture is None:
        return None
    return decode(picture.to(device).float() / 255, observations.averaging_space)


def as_filmed(
    observations: Observations,
    position: int,
    image: Float[Tensor, "H W 3"],
    alpha: Float[Tensor, "H W"],
) -> Float[Tensor, "H W 3"]:
    """Composite a training camera's render over what was behind the person in one frame.

    Args:
        observations: with the background, if it is known.
        position: of the frame.
        image: on black, sRGB in [0, 1].
        alpha: coverage.
    """
    behind = light_behind(observations, position, image.device)
    return image if behind is None else before(behind, image, alpha, observations.averaging_space)


def before(
    behind: Float[Tensor, "H W 3"],
    image: Float[Tensor, "H W 3"],
    alpha: Float[Tensor, "H W"],
    averaging_space: str,
) -> Float[Tensor, "H W 3"]:
    """Composite a render, sRGB on black, before light that is behind it; sRGB in [0, 1]."""
    light = over(decode(image, averaging_space), alpha, behind)
    return encode(light, averaging_space)
