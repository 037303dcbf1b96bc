"""Studio source: one clothed person, one camera to train and several to test, all truth known.

Conventions. World: +Y up, the floor at y = 0, metres; the person starts facing camera 0, which
stands on +Z. There are `SUBFRAMES` sub-frames a frame; frame f is sub-frame SUBFRAMES * f. The
background is black. Everything rendered is an instant: blur is the mean of instants.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Float, UInt8
from pydantic import Field
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.config.section import Count, Fraction, NonNegative, Params, Positive
from deblur_avatar.errors import ConfigError
from deblur_avatar.imaging.color import linear_to_srgb
from deblur_avatar.imaging.exposure import (
    blur_windows,
    exposure_seconds,
    frames_before,
    frames_with_whole_window,
)
from deblur_avatar.rendering.mesh_rendering import (
    Lighting,
    Picture,
    View,
    render,
)
from deblur_avatar.rendering.visibility import seen_cells, seen_pixels
from deblur_avatar.sources.source import Segment
from deblur_avatar.sources.studio.cameras import place_cameras
from deblur_avatar.sources.studio.motion import Moves, move
from deblur_avatar.sources.studio.noise import disturb
from deblur_avatar.sources.studio.person import Person, create_person

SUBFRAMES = 8  # instants a frame that true blur is summed of
SEEN_CELLS = 3  # along a triangle's edge
LIGHTING = Lighting(
    ambient=0.55, sky=0.25, lamps=(((0.5, 0.6, 1.0), 0.18), ((-0.6, 0.5, -0.8), 0.12))
)
BETAS = (-0.3, 0.6, -0.4, 0.5, 0.3)  # a lean person; further shape numbers are 0


class StudioParams(Params):
    """A synthetic person with exact truth.

    `motion` names a motion of `sources/studio`; `window` sub-frames (480 a second) are averaged
    into the true blur. Pose noise is correlated over `noise_correlation_s`.
    """

    source: Literal["studio"]
    motion: str
    frames: Annotated[int, Field(ge=2)]
    fps: Positive
    image_size: Annotated[int, Field(ge=8)]  # square, pixels
    test_cameras: Count
    test_stride: Count
    window: Count
    samples_per_axis: Count  # rays a pixel is (samples_per_axis)^2
    noise_degrees: NonNegative  # root mean square of each joint's angle of error
    noise_mm: NonNegative  # root mean square of the root's distance from its place
    noise_correlation_s: NonNegative
    held_out: Fraction  # last part of the clip, kept from training

    def load(
        self, body: Body, segment: Segment, generator: torch.Generator
    ) -> tuple[Clip, Reference]:
        """Film the scene; its mattes are known."""
        return load_studio(self, body, generator)

    def missing_files(self, where: str) -> tuple[str, ...]:
        """None: everything is made here."""
        return ()


@dataclass(frozen=True)
class Scene:
    """All that is decided before the first picture is taken."""

    params: StudioParams
    person: Person
    cameras: Cameras
    timestamps: Float[Tensor, " F"]
    true: Moves  # at timestamps
    subtimes: Float[Tensor, " M"]
    fine: Moves  # at subtimes
    held_out_from: int
    training: tuple[int, ...]  # frames whose whole exposure lies in the training part
    testing: tuple[int, ...]  # frames of the test views


def load_studio(
    params: StudioParams, body: Body, generator: torch.Generator
) -> tuple[Clip, Reference]:
    """Film the scene.

    Args:
        params: of the clip.
        body: whose joints the person has; the poses are given for it.
        generator: draws the noise of the initial poses.

    Returns:
        The training camera's clip, and the sharp truth seen by all test cameras.

    Raises:
        ConfigError: if the clip is too short for its blur window, nothing is left for training, or
            the motion is not known.
    """
    return film(set_scene(params, body), generator)


def film(scene: Scene, generator: torch.Generator) -> tuple[Clip, Reference]:
    """Take all pictures of a scene that is set, as `load_studio` does."""
    return _film_clip(scene, generator), _film_reference(scene)


def set_scene(params: StudioParams, body: Body) -> Scene:
    """Dress the person, place the cameras and rehearse the motion.

    Raises:
        ConfigError: as `load_studio`.
    """
    timestamps = torch.arange(params.frames, dtype=torch.float64) / params.fps
    instants = SUBFRAMES * (params.frames - 1) + 1
    subtimes = torch.arange(instants, dtype=torch.float64) / (SUBFRAMES * params.fps)
    held_out_from = max(1, round(params.frames * (1 - params.held_out)))
    training, testing = _split(params, timestamps, held_out_from)
    training_seconds = held_out_from / params.fps
    betas = torch.zeros(body.shape_dirs.shape[2])
    betas[: len(BETAS)] = torch.tensor(BETAS)[: len(betas)]
    return Scene(
        params=params,
        person=create_person(body, betas),
        cameras=place_cameras(params.test_cameras, params.image_size),
        timestamps=timestamps,
        true=move(params.motion, timestamps, training_seconds),
        subtimes=subtimes,
        fine=move(params.motion, subtimes, training_seconds),
        held_out_from=held_out_from,
        training=training,
        testing=testing,
    )


def _split(
    params: StudioParams, timestamps: Float[Tensor, " F"], held_out_from: int
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Frames whose whole exposure lies in the training part, and frames that test."""
    try:
        whole = frames_with_whole_window(params.frames, SUBFRAMES, params.window)
    except ValueError as error:
        raise ConfigError(f"clip.window: {error}") from None
    exposure = exposure_seconds(params.window, SUBFRAMES, params.fps)
    end = held_out_from / params.fps
    training = tuple(f for f in frames_before(timestamps, exposure, end) if f in whole)
    if not training:
        raise ConfigError(
            f"clip: no frame is left for training: {params.frames} frames, of which "
            f"{params.frames - held_out_from} are held out, and a window of {params.window} "
            "sub-frames; take more frames or a shorter window"
        )
    held_out = tuple(f for f in whole if f >= held_out_from)
    return training, training[:: params.test_stride] + held_out[:: params.test_stride]


def _film_clip(scene: Scene, generator: torch.Generator) -> Clip:
    """What the training camera takes, and the poses that fitting starts from."""
    params, betas = scene.params, scene.person.betas
    frames, in_srgb, in_linear = _film_training(scene)
    initial = disturb(
        scene.true,
        scene.timestamps,
        params.noise_degrees,
        params.noise_mm,
        params.noise_correlation_s,
        generator,
    )
    return Clip(
        frames=frames[None, ..., :3],
        mattes=frames[None, ..., 3],
        recorded=(0,),
        train_camera=0,
        cameras=scene.cameras,
        timestamps=scene.timestamps.float(),
        blurred=False,
        exposure=0.0,
        averaging_space="linear",
        held_out_from=scene.held_out_from,
        initial=initial.poses(betas),
        exact=scene.true.poses(betas),
        true_blur_srgb=in_srgb[..., :3],
        true_blur_linear=in_linear[..., :3],
        true_blur_mattes=in_linear[..., 3],
        frame_indices=tuple(frames_with_whole_window(params.frames, SUBFRAMES, params.window)),
        true_blur_exposure=exposure_seconds(params.window, SUBFRAMES, params.fps),
    )


def _film_training(
    scene: Scene,
) -> tuple[UInt8[Tensor, "F H W 4"], UInt8[Tensor, "E H W 4"], UInt8[Tensor, "E H W 4"]]:
    """The training camera's frames, and their blur averaged in sRGB and in linear light."""
    params, frames = scene.params, []

    def subframes() -> Iterator[UInt8[np.ndarray, "H W 4"]]:
        view = View.of(scene.cameras, 0, params.samples_per_axis)
        instants = scene.person.posed(scene.fine)
        total = len(scene.subtimes)
        for index, vertices in enumerate(run.progress(instants, "filming", total)):
            coded = encode(render(vertices, scene.person.mesh, view, LIGHTING))
            if index % SUBFRAMES == 0:
                frames.append(coded)
            yield coded

    first, second = itertools.tee(subframes())
    windows = params.frames, SUBFRAMES, params.window
    in_srgb, in_linear = (
        blur_windows(first, *windows, "srgb"),
        blur_windows(second, *windows, "linear"),
    )
    blurred = list(zip(in_srgb, in_linear, strict=True))
    srgb, linear = (_stacked(blurs) for blurs in zip(*blurred, strict=True))
    return _stacked(frames), srgb, linear


def _film_reference(scene: Scene) -> Reference:
    """Sharp views of every test camera, and which of their pixels the training camera saw."""
    person, faces = scene.person, scene.person.mesh.faces
    trained = person.posed(_at(scene.true, scene.training))
    seen = seen_cells(trained, faces, View.of(scene.cameras, 0, 1), SEEN_CELLS)
    shown = list(person.posed(_at(scene.true, scene.testing)))
    count = scene.params.test_cameras
    images, masks = [], []
    for index in run.progress(range(1, count + 1), "filming the truth"):
        view = View.of(scene.cameras, index, scene.params.samples_per_axis)
        for vertices in shown:
            images.append(encode(render(vertices, person.mesh, view, LIGHTING)))
            masks.append(np.uint8(255) * seen_pixels(vertices, faces, view, seen))
    views, frame_indices = _stacked(images), torch.tensor(scene.testing).repeat(count)
    return Reference(
        images=views[..., :3],
        mattes=views[..., 3],
        seen=_stacked(masks),
        camera_indices=torch.arange(1, count + 1).repeat_interleave(len(scene.testing)),
        frame_indices=frame_indices,
        novel_pose=(frame_indices >= scene.held_out_from).long(),
        background=(0.0, 0.0, 0.0),
        motion_times=scene.subtimes.float(),
        motion=scene.fine.poses(person.betas),
    )


def encode(picture: Picture) -> UInt8[np.ndarray, "H W 4"]:
    """A picture over black as 8-bit sRGB, and its coverage as a fourth channel."""
    srgb = linear_to_srgb(torch.from_numpy(picture.light)).numpy()
    both = np.concatenate([srgb, picture.coverage[..., None]], -1)
    return np.rint(both.clip(0, 1) * 255).astype(np.uint8)


def _stacked(images: Sequence[UInt8[np.ndarray, "*image"]]) -> UInt8[Tensor, " F *image"]:
    return torch.from_numpy(np.stack(images))


def _at(moves: Moves, frames: tuple[int, ...]) -> Moves:
    chosen = list(frames)
    swing = None if moves.swing is None else moves.swing[chosen]
    return Moves(moves.global_orient[chosen], moves.body_pose[chosen], moves.transl[chosen], swing)
