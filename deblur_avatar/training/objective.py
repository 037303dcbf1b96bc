"""The terms that one step of fitting adds up, each already weighed.

Three walks: over the table of losses, over the avatar's regularisers, over the trajectory's priors.
A term whose weight is 0 is not computed.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.avatar import AvatarModel, Rendering, TrainingStep
from deblur_avatar.imaging.exposure import encode
from deblur_avatar.motion.trajectory import Instants, MotionParams, Trajectory
from deblur_avatar.training.losses import LOSSES, Comparison, Loss
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.picture_losses import KNOWN, has_kernel, picture_losses
from deblur_avatar.training.supervision import Compared
from deblur_avatar.training.targets import Target

# Not a parameter: a unit. Of a picture that is cut to a person's path over a clip, she is so much.
PERSON_SHARE = 0.12


class Objective:
    """What an avatar and its motion are held to.

    Args:
        avatar: that is fitted.
        trajectory: its motion.
        observations: what is known of the clip.
        recipe: weights of the losses and of the avatar's regularisers.
        motion: weights of the motion's priors.
        device: of the pictures that are compared.
    """

    def __init__(
        self,
        avatar: AvatarModel,
        trajectory: Trajectory,
        observations: Observations,
        recipe: RecipeParams,
        motion: MotionParams,
        device: torch.device,
    ) -> None:
        self._avatar, self._trajectory = avatar, trajectory
        self._observations, self._motion = observations, motion
        self._weights = _weights_of_losses(recipe, observations)
        self._losses = _chosen(recipe, device)

    @property
    def perceptual(self) -> str | None:
        """The loss that sees structure, if any."""
        names = [LOSSES[name].name_in_records for name in self._losses]
        return next((name for name in names if name is not None), None)

    def pictures(
        self, compared: Sequence[Compared], alpha: Tensor, target: Target
    ) -> dict[str, Tensor]:
        """How far renders and coverage are from a frame and its matte."""
        pictures = [(c.share, target.behind(c.image, c.alpha)) for c in compared]
        terms = self._known_to_kernel(pictures, alpha, target)
        space = self._avatar.averaging_space
        rest = [name for name in self._losses if name not in terms]
        shown = pictures if rest else []
        images = [(share, target.comparable_part(encode(image, space))) for share, image in shown]
        for name in rest:
            row, compare = self._losses[name]
            if row.region == "coverage":
                apart = compare(alpha, target.matte)
            else:
                seen = [share * _in_region(row, compare, image, target) for share, image in images]
                apart = torch.stack(seen).sum()
            terms[name] = self._weights[name] * target.weight * apart
        return {name: terms[name] for name in self._losses}

    def _known_to_kernel(
        self, pictures: list[tuple[float, Tensor]], alpha: Tensor, target: Target
    ) -> dict[str, Tensor]:
        """Those terms that come of one pass over a picture, if it alone is compared."""
        if len(pictures) > 1 or pictures[0][0] != 1 or not has_kernel(pictures[0][1], alpha):
            return {}
        names = {
            compare: name
            for name, (row, compare) in self._losses.items()
            if (row.region, compare) in KNOWN
        }
        weights = {compare: self._weights[name] * target.weight for compare, name in names.items()}
        space = self._avatar.averaging_space
        losses = picture_losses(pictures[0][1], alpha, target, space, weights)
        return {names[compare]: loss for compare, loss in losses.items()}

    def regularisers(self, rendering: Rendering, step: TrainingStep) -> dict[str, Tensor]:
        """What the avatar is held to, whatever it looks like."""
        terms = self._avatar.regularisers(rendering, step)
        weights = step.fitting.weights(step, self._observations.occluded_fraction)
        return {name: weights[name] * term() for name, term in terms.items() if weights[name] > 0}

    def priors(self, index: int, instants: Instants) -> dict[str, Tensor]:
        """What is known of the motion beforehand."""
        weights = self._motion.weights()
        terms = self._trajectory.priors(index, instants, self._observations)
        return {name: weights[name] * term() for name, term in terms.items() if weights[name] > 0}


def _weights_of_losses(recipe: RecipeParams, observations: Observations) -> dict[str, float]:
    """Weights of means over the picture, which are those over the person if these are asked for.

    A mean over the person is one over the picture, times how much larger the picture is. Weights
    hold for a picture of which the person is `PERSON_SHARE`.
    """
    weights = dict(recipe.losses)
    if recipe.mean_over == "picture":
        return weights
    share = float(observations.mattes[observations.shown].float().mean()) / 255
    larger = {name for name in weights if LOSSES[name].region != "box"}
    return {
        name: weight * (PERSON_SHARE / share if name in larger else 1.0)
        for name, weight in weights.items()
    }


def _chosen(recipe: RecipeParams, device: torch.device) -> dict[str, tuple[Loss, Comparison]]:
    """The losses that count: those with a weight, for which this machine has what they take."""
    chosen: dict[str, tuple[Loss, Comparison]] = {}
    for name, row in LOSSES.items():
        if recipe.losses[name] > 0 and row.substitute_for not in chosen:
            compare = row.on(device)
            if compare is not None:
                chosen[name] = row, compare
    return chosen


def _in_region(row: Loss, compare: Comparison, image: Tensor, target: Target) -> Tensor:
    if row.region == "picture":
        return compare(image, target.image)
    left, top, right, bottom = target.box
    cut = (slice(top, bottom), slice(left, right))
    return compare(image[cut], target.image[cut])
