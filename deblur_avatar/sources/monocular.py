"""Monocular source: a person in one's own video, blurred as it is, no ground truth.

The one recorded camera stands at the origin of the world, axes as OpenCV's, and never moves: where
it did move, the person moves before it (`given_poses` says why that loses nothing).
"""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.config.reading import expand_environment, missing_file
from deblur_avatar.config.section import (
    Count,
    Params,
    Positive,
)
from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.exposure import GUESS_STD
from deblur_avatar.sources.borders import without_borders
from deblur_avatar.sources.footage import Footage, read_footage
from deblur_avatar.sources.footage_camera import camera_of_footage
from deblur_avatar.sources.given_masks import read_masks
from deblur_avatar.sources.given_poses import read_poses
from deblur_avatar.sources.keypoint_files import follow_person, read_keypoints
from deblur_avatar.sources.source import Segment

# Seconds: a frame's time at 24 frames a second. Where frames are farther apart, they were thinned
# out or taken one by one, and no shutter was open the longer for it.
LONGEST_FRAME = 1 / 24


class MonocularParams(Params):
    """One video of one person by one camera, blurred as it is; the camera may move.

    `path` is a video or a folder of pictures. It, `keypoints`, `masks` and `poses` may hold
    `$(VARIABLE:-default)`; null means that these are estimated from the frames.
    """

    source: Literal["monocular"]
    path: str
    frames: tuple[Annotated[int, Field(ge=0)], int | None]  # first, one past last; null: all
    stride: Count  # every n-th of them is taken
    fps: Positive  # of a folder of pictures; a video brings its own times
    image_height: Count  # frames are scaled down to this height
    focal: Literal["estimated", "field_of_view"] | Positive  # pixels of the footage as recorded
    field_of_view: Annotated[float, Field(gt=5, lt=150)]  # degrees, longer side; the last resort
    # Seconds the shutter is open; null: `shutter` says; estimated: `shutter` is a first guess, of
    # an interval of a 24th of a second at most.
    exposure_s: Literal["estimated"] | Positive | None
    shutter: Annotated[float, Field(gt=0, le=1)]  # exposure as a share of the frame interval
    averaging_space: Literal["srgb", "linear"]
    held_out: Annotated[float, Field(ge=0, lt=1)]  # last part of the clip, kept from training
    keypoints: str | None  # OpenPose's or COCO's JSON
    masks: str | None  # folder of pictures; not black is person
    poses: str | None  # .npz

    def load(
        self, body: Body, segment: Segment, generator: torch.Generator
    ) -> tuple[Clip, Reference]:
        """Read the video and what came along with it."""
        return load_monocular(self, body, segment)

    def missing_files(self, where: str) -> tuple[str, ...]:
        """The video and what came along with it, where they are not here."""
        named = {
            "path": (self.path, "video and no folder"),
            "keypoints": (self.keypoints, "keypoints"),
            "masks": (self.masks, "folder of masks"),
            "poses": (self.poses, "file of poses"),
        }
        return tuple(
            reason
            for key, (text, wanted) in named.items()
            if text is not None
            for reason in missing_file(text, f"{where}.{key}", wanted)
        )


def load_monocular(params: MonocularParams, body: Body, segment: Segment) -> tuple[Clip, Reference]:
    """Read a video or a folder of pictures, and whatever the user brought along with it.

    Args:
        params: of the scene.
        body: whose poses the user's are.
        segment: tells the person from the background where the focal length is to be estimated.

    Returns:
        The clip, and a reference without views.

    Raises:
        ConfigError: if there is no such footage or the parameters contradict each other.
        ArtifactError: if a file is damaged, or something brought along does not fit the footage.
    """
    path = _path(params.path, "path")
    footage = read_footage(path, params.frames, params.stride, params.fps, params.image_height)
    if params.keypoints is None and params.masks is None and params.poses is None:
        footage = without_borders(footage, str(path))  # which what comes along would have, too
    height, width = footage.frames.shape[1:3]
    mattes = None
    if params.masks is not None:
        folder = _path(params.masks, "masks")
        mattes = read_masks(folder, footage.numbers, footage.total, (width, height))
    count = len(footage.frames)
    exposure, exposure_std = _exposure(params, footage.interval)
    clip = Clip(
        frames=footage.frames[None],
        mattes=None if mattes is None else mattes[None],
        landmarks=_landmarks(params, footage),
        recorded=(0,),
        train_camera=0,
        cameras=camera_of_footage(
            path, footage, params.focal, params.field_of_view, mattes, segment
        ),
        timestamps=(footage.timestamps - footage.timestamps[0]).float(),
        numbers=None if footage.numbers == tuple(range(count)) else footage.numbers,
        blurred=True,
        exposure=exposure,
        exposure_std=exposure_std,
        averaging_space=params.averaging_space,
        held_out_from=max(1, round(count * (1 - params.held_out))),
        initial=_poses(params, footage, body),
        exact=None,
        true_blur_srgb=None,
        true_blur_linear=None,
        true_blur_mattes=None,
        frame_indices=None,
        true_blur_exposure=None,
    )
    return clip, _no_truth(height, width)


def _exposure(params: MonocularParams, interval: float) -> tuple[float, float | None]:
    """Seconds the shutter was open, and how far that may be off where it is a guess."""
    if params.exposure_s is None:
        return params.shutter * interval, None
    if params.exposure_s == "estimated":
        return params.shutter * min(interval, LONGEST_FRAME), GUESS_STD
    return params.exposure_s, None


def _path(text: str, key: str) -> Path:
    return Path(expand_environment(text, f"clip.{key}"))


def _landmarks(params: MonocularParams, footage: Footage) -> Float[Tensor, "1 F L 3"] | None:
    if params.keypoints is None:
        return None
    path = _path(params.keypoints, "keypoints")
    people = read_keypoints(path)
    wanted = footage.total or max(footage.numbers) + 1
    # COCO's lists end with the last frame in which someone was found.
    too_many = footage.total is not None and len(people) > wanted  # else who knows how many
    if too_many or (path.is_dir() and len(people) < wanted):
        raise ArtifactError(
            f"{path} is of {len(people)} frames, the footage of {wanted}; give one entry for each "
            "frame of the file, counted from 0"
        )
    people += [[]] * (wanted - len(people))
    person = follow_person([people[number] for number in footage.numbers], str(path))
    if not person.any():
        raise ArtifactError(f"{path} shows no person in the frames asked for; check clip.frames")
    marks = torch.from_numpy(person.astype(np.float32))
    marks[..., :2] *= footage.frames.shape[2] / footage.recorded_size[0]
    _check_inside(marks, footage, path)
    return marks[None]


def _check_inside(marks: Float[Tensor, "F L 3"], footage: Footage, path: Path) -> None:
    height, width = footage.frames.shape[1:3]
    seen = marks[marks[..., 2] > 0]
    inside = (seen[:, 0] <= 1.5 * width) & (seen[:, 1] <= 1.5 * height) & (seen[:, :2] >= 0).all(1)
    if inside.float().mean() < 0.5:
        raise ArtifactError(
            f"{path}: most points lie outside the frames of {footage.recorded_size} pixels; "
            "keypoints are in pixels of the footage as recorded"
        )


def _poses(params: MonocularParams, footage: Footage, body: Body) -> Poses | None:
    if params.poses is None:
        return None
    return read_poses(_path(params.poses, "poses"), footage.numbers, footage.total, body)


def _no_truth(height: int, width: int) -> Reference:
    none = torch.zeros(0, dtype=torch.long)
    return Reference(
        images=torch.zeros(0, height, width, 3, dtype=torch.uint8),
        mattes=torch.zeros(0, height, width, dtype=torch.uint8),
        seen=None,
        camera_indices=none,
        frame_indices=none,
        novel_pose=none,
        background=(0.0, 0.0, 0.0),
        motion_times=None,
        motion=None,
    )
