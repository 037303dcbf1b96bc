"""A fine-grained avatar, and observations of it: what a perfect fit is."""

import dataclasses

import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.plain_avatar import PlainAvatar
from deblur_avatar.avatars.render import render_avatar
from tests.conftest import colourful


def fine_avatar(body: Body) -> PlainAvatar:
    """Two thousand small Gaussians on the surface."""
    model = colourful(body, 5, count=2000)
    with torch.no_grad():
        model.gaussians.log_scales.clamp_(max=-3.7)  # 2.5 cm
    return model


def filmed_with(observations: Observations, model: PlainAvatar) -> Observations:
    """The same frames with this avatar in them."""
    images, alphas = render_avatar(model, observations.poses, observations.camera)
    return dataclasses.replace(
        observations,
        frames=(images * 255).round().to(torch.uint8),
        mattes=(alphas * 255).round().to(torch.uint8),
    )
