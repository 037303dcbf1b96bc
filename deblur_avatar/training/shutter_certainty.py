"""How surely blurred frames tell how long the shutter was open.

Conventions. Shutters are compared by the natural logarithm of their ratio, so that 0.1 is some ten
per cent. All else that was fitted is taken as it is.
"""

import logging
import math
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.model import AvatarModel, render_avatar
from deblur_avatar.geometry.rotations import quat_to_axis_angle
from deblur_avatar.motion.clip import WIDEST, ClipMotion

logger = logging.getLogger(__name__)

GUESS_STD = math.log(2)  # of a first guess: it is believed to within a factor of two
STEP = 0.05  # to either side, where a picture's change with the shutter is measured
MIN_VALUE = 1 / 255  # root mean square change of the person's pixels with a shutter twice as long
PARTS = 8  # of the clip; frames next to each other share most of what is wrong with them


def told_by_frames(model: AvatarModel, motion: ClipMotion, observations: Observations) -> float:
    """Standard deviation of the logarithm of the shutter, as training frames alone tell it.

    Each part of the clip has a shutter of its own that explains it best: a Gauss-Newton step from
    the fitted one. How these disagree, and how far they lie from the fitted one in the mean, is
    the error; so neighbouring pixels and frames, which share theirs, do not count as many.

    Returns:
        Infinity where no picture changes with the shutter by more than it is rounded, and of a
        single frame.

    Source: the sandwich estimator with clusters (Huber 1967; Liang and Zeger 1986) of least squares
    on the pixels.
    """
    frames = [index for index in observations.train if observations.weights[index] > 0]
    parts = min(PARTS, len(frames))
    slopes, curvatures = torch.zeros(parts), torch.zeros(parts)
    for place, index in enumerate(frames):
        slope, curvature = _pull(model, motion, observations, index)
        slopes[place * parts // len(frames)] += slope
        curvatures[place * parts // len(frames)] += curvature
    values = 3 * float(observations.mattes[frames].sum()) / 255
    change = GUESS_STD * math.sqrt(float(curvatures.sum()) / max(values, 1))
    if parts < 2 or change < MIN_VALUE:
        return math.inf
    spread = slopes.square().sum() * parts / (parts - 1)
    return float(spread.sqrt() / curvatures.sum())


def settle_shutter(
    model: AvatarModel, motion: ClipMotion, observations: Observations
) -> dict[str, Any]:
    """Keep a fitted shutter, or go back to the guess where nothing moved enough to tell it.

    Its error is the frames' (`told_by_frames`), and how far it moved in the last half of the stage:
    what it had not yet found then is about what it has not yet found now. Frames and guess are
    weighed as independent.

    Returns:
        `shutter_s` and `shutter_std_s`, seconds, and who told it: `shutter_from` frames or guess.
    """
    assert motion.halfway is not None
    told = told_by_frames(model, motion, observations)
    source = "frames" if told < GUESS_STD else "guess"
    moved = float(motion.log_shutter.detach() - motion.halfway)
    if source == "guess":
        with torch.no_grad():
            motion.log_shutter.zero_()
        std = GUESS_STD
        told_as = "nothing moved enough to tell: the guess stands"
    else:
        std = (1 / (told**2 + moved**2) + 1 / GUESS_STD**2) ** -0.5
        told_as = f"it moved by {math.expm1(moved):+.1%} in the last half of the stage"
    shutter = motion.estimated_shutter(observations.timestamps)
    assert shutter is not None
    logger.info(
        "the shutter was open for %.1f ms, give or take %.1f; %s",
        1e3 * shutter, 1e3 * shutter * std, told_as,
    )  # fmt: skip
    return {"shutter_s": shutter, "shutter_std_s": shutter * std, "shutter_from": source}


def _pull(
    model: AvatarModel, motion: ClipMotion, observations: Observations, index: int
) -> tuple[float, float]:
    """Slope and curvature of half the squared residuals of one frame over the shutter."""
    middle = float(motion.log_shutter.detach().clamp(STEP - WIDEST, WIDEST - STEP))
    seen = observations.frames[index].float() / 255
    shorter, here, longer = (
        _exposed(model, motion, observations, index, middle + step) for step in (-STEP, 0.0, STEP)
    )
    change = (longer - shorter) / (2 * STEP)
    return float((change * (here - seen)).sum()), float(change.square().sum())


def _exposed(
    model: AvatarModel,
    motion: ClipMotion,
    observations: Observations,
    index: int,
    log_shutter: float,
) -> Float[Tensor, "H W 3"]:
    """The render of one frame, had the shutter been open for so long."""
    fitted = motion.log_shutter.detach().clone()
    camera = observations.train_camera
    width, height = observations.cameras.sizes[camera].tolist()
    with torch.no_grad():
        motion.log_shutter.fill_(log_shutter)
        instants = motion(index)
        motion.log_shutter.copy_(fitted)
        turns = quat_to_axis_angle(instants.quats)
    image, _ = render_avatar(
        model,
        Poses(
            betas=model.betas.detach().cpu(),
            global_orient=turns[:, 0],
            body_pose=turns[:, 1:],
            transl=instants.transl,
        ),
        observations.cameras.Ks[camera].to(instants.transl),
        observations.cameras.viewmats[camera].to(instants.transl),
        width,
        height,
        frame=index,
        average=True,
    )  # fmt: skip
    return image[0].cpu()
