"""Unfitted studio: another person before the studio's cameras, whom no fitter's model reaches.

Conventions. As the studio's (`source.py`), which films. What is drawn at random (bumps, the error
of the given shape and poses, the sensor's noise) comes from a seed of its own, so that scenes that
differ in their blur alone show the same person in the same poses.
"""

from dataclasses import replace
from typing import Annotated, Literal

import torch
from jaxtyping import Float, UInt8
from pydantic import Field
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.config.section import Count, Fraction, NonNegative, Params, Positive
from deblur_avatar.imaging.color import srgb_to_linear
from deblur_avatar.sources.source import Segment
from deblur_avatar.sources.studio.acting import Act, learn, missing_motion
from deblur_avatar.sources.studio.cameras import STUDIO, RingParams, place_cameras
from deblur_avatar.sources.studio.person import Person, create_person
from deblur_avatar.sources.studio.sensor import NoiseParams, gains, record
from deblur_avatar.sources.studio.source import SUBFRAMES, Scene, StudioParams, film, set_scene
from deblur_avatar.sources.studio.texture import LookParams
from deblur_avatar.sources.studio.unfitted_body import (
    UnfittedParams,
    swing_of_joints,
    unfitted_body,
    with_more_hair,
)

REHEARSED = "still"  # the motion of the studio that another takes the place of


class UnfittedStudioParams(Params):
    """A studio scene as far from the fitter's model as one likes; each section may be null: off."""

    source: Literal["unfitted_studio"]
    seed: Annotated[int, Field(ge=0)]  # of all that is drawn at random
    motion: str  # of `sources/studio/motion.py`, `builtin:<name>`, or a file
    start: NonNegative  # seconds into a motion that is built in or a file
    turns: float  # whole turns about the vertical that are added over the clip
    frames: Annotated[int, Field(ge=2)]
    fps: Positive
    image_size: Annotated[int, Field(ge=8)]  # square, pixels
    test_cameras: Count
    test_stride: Count
    window: Count
    samples_per_axis: Count  # rays a pixel is (samples_per_axis)^2
    noise_degrees: NonNegative  # as the studio's
    noise_mm: NonNegative
    noise_correlation_s: NonNegative
    held_out: Fraction  # last part of the clip, kept from training
    betas: tuple[float, ...]  # the person's; as many as the body has, further ones are 0
    betas_error: NonNegative  # of the given shape: standard deviations from the true one, any way
    look: LookParams | None
    ring: RingParams | None
    unfitted_body: UnfittedParams | None
    noise: NoiseParams | None  # of the training camera's sensor

    def load(
        self, body: Body, segment: Segment, generator: torch.Generator
    ) -> tuple[Clip, Reference]:
        """Film the scene; its mattes are known."""
        return load_unfitted_studio(self, body)

    def missing_files(self, where: str) -> tuple[str, ...]:
        """A motion's file, if it is not there."""
        return missing_motion(self.motion, f"{where}.motion")


def load_unfitted_studio(params: UnfittedStudioParams, body: Body) -> tuple[Clip, Reference]:
    """Film the scene.

    Args:
        params: of the clip.
        body: whose joints the person has; the poses are given for it.

    Returns:
        The training camera's clip, and the sharp truth seen by all test cameras.

    Raises:
        ConfigError: as `load_studio`, or for a motion that is not there or too short.
        ArtifactError: if a motion's file is damaged.
    """
    generator = torch.Generator().manual_seed(params.seed)
    scene = _set(params, body, generator)
    clip, reference = film(scene, generator)
    assert clip.initial is not None
    away = torch.randn(len(scene.person.betas), generator=generator)
    error = params.betas_error * away / away.norm()
    given = replace(clip.initial, betas=scene.person.betas + error)
    return _recorded(replace(clip, initial=given), params.noise, generator), reference


def _set(params: UnfittedStudioParams, body: Body, generator: torch.Generator) -> Scene:
    shared = StudioParams.model_fields.keys() - {"source", "motion"}
    rehearsed = StudioParams(
        source="studio", motion=REHEARSED, **{name: getattr(params, name) for name in shared}
    )
    scene = set_scene(rehearsed, body)
    person = _person(params, body, generator)
    seconds = params.frames / params.fps
    done = learn(Act(params.motion, params.start, params.turns, seconds), body, person.betas)
    training_seconds = scene.held_out_from / params.fps
    true = done(scene.timestamps, training_seconds)
    fine = done(scene.subtimes, training_seconds)
    if params.unfitted_body is not None and params.unfitted_body.swing > 0:
        swing = swing_of_joints(body, person.betas, fine, scene.subtimes)
        fine = replace(fine, swing=params.unfitted_body.swing * swing)
        true = replace(true, swing=params.unfitted_body.swing * swing[::SUBFRAMES])
    ring = STUDIO if params.ring is None else params.ring
    cameras = place_cameras(params.test_cameras, params.image_size, ring)
    return replace(scene, person=person, cameras=cameras, true=true, fine=fine)


def _person(params: UnfittedStudioParams, body: Body, generator: torch.Generator) -> Person:
    betas = torch.zeros(body.shape_dirs.shape[2])
    betas[: len(params.betas)] = torch.tensor(params.betas)[: len(betas)]
    unfitted = params.unfitted_body
    if unfitted is None:
        return create_person(body, betas, params.look)
    person = create_person(unfitted_body(body, unfitted, generator), betas, params.look)
    return with_more_hair(person, unfitted.hair_mm)


def _recorded(clip: Clip, noise: NoiseParams | None, generator: torch.Generator) -> Clip:
    """The frames, sharp and blurred, as a sensor reads them where the matte has anything."""
    if noise is None:
        return clip
    assert clip.mattes is not None
    assert clip.true_blur_mattes is not None

    def read(
        frames: UInt8[Tensor, "F H W 3"] | None, mattes: UInt8[Tensor, "F H W"]
    ) -> UInt8[Tensor, "F H W 3"]:
        assert frames is not None
        gain: Float[Tensor, " 3"] = gains(0.0, None)
        light = srgb_to_linear(frames.float() / 255)
        seen = [record(image, gain, noise, generator) for image in light]
        return torch.stack(seen) * (mattes > 0)[..., None]

    return replace(
        clip,
        frames=read(clip.frames[0], clip.mattes[0])[None],
        true_blur_srgb=read(clip.true_blur_srgb, clip.true_blur_mattes),
        true_blur_linear=read(clip.true_blur_linear, clip.true_blur_mattes),
    )
