"""Input of a fit in the suite: blurred, damaged as asked for, preprocessed."""

import math
from collections.abc import Mapping

import torch
from jaxtyping import UInt8
from torch import Tensor

from benchmarks.stress.damage import DAMAGES, averaged_light
from deblur_avatar import run
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.errors import ConfigError
from deblur_avatar.motion.trajectory import LEVER
from deblur_avatar.pipeline.blur import BlurParams, blur
from deblur_avatar.pipeline.preprocess import Preprocessed, PreprocessParams, preprocess
from deblur_avatar.sources.studio.source import SUBFRAMES

UNDAMAGED_DEGREES = 1.5  # `noise_degrees` of the suite's scenes


def prepare(
    clip: Clip,
    body: Body,
    damage: Mapping[str, float],
    image_height: int,
    validation_stride: int,
    seed: int,
) -> Preprocessed:
    """Run `blur` and `preprocess`, with the damage done in between.

    Raises:
        ConfigError, ArtifactError: as the stages do for what they refuse.
    """
    assert clip.true_blur_exposure is not None  # the studio knows it
    fps = 1 / float(clip.timestamps.diff().mean())
    window = round(clip.true_blur_exposure * SUBFRAMES * fps)
    params = BlurParams(
        frames="true", factor=SUBFRAMES, window=window, averaging_space=averaged_light(damage)
    )
    blurry = blur(clip, params)
    generator = torch.Generator().manual_seed(run.derive_seed(seed, "damage"))
    for name, amount in damage.items():
        if name not in DAMAGES:
            raise ConfigError(f"no damage {name!r}; known: {', '.join(DAMAGES)}")
        blurry = DAMAGES[name](blurry, amount, generator)
    given = PreprocessParams(
        poses="given", masks="given", background="none", depth="unknown", margin=0.1,
        validation_stride=validation_stride, pose_std_degrees=_pose_std(damage),
    )  # fmt: skip
    return preprocess(blurry, body, given, image_height=image_height, detect=_nobody)


def _pose_std(damage: Mapping[str, float]) -> float:
    """How far the poses are said to be off, degrees: as far as noise that was added puts them.

    Whoever has poses knows how good they are. Other damage (poses held, missing, turned) is not
    said, since nobody would have noticed it.
    """
    added = [damage.get(name, 0.0) for name in ("noise_iid_degrees", "noise_correlated_degrees")]
    shift = math.degrees(damage.get("root_noise_cm", 0.0) / 100 / LEVER)
    return math.hypot(UNDAMAGED_DEGREES, *added, shift)


def _nobody(frames: UInt8[Tensor, "F H W 3"]) -> Landmarks:
    raise ConfigError("the stability suite brings poses and masks; nothing is to be detected")
