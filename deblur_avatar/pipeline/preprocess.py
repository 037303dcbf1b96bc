"""Preprocessing: undistorted crops, mattes and one body pose a frame, from blurred frames.

Three sets of observations share cameras, crops and the split: the blurred frames, the sharp frames
with the same poses (for `oracle`), and the sharp frames with exact poses (for `ceiling`).
"""

import logging
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import torch
from jaxtyping import Bool, Float, UInt8
from pydantic import Field
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.body_estimation.body_fit import fit_body
from deblur_avatar.body_estimation.fit_quality import measure_fit
from deblur_avatar.body_estimation.landmarks import Landmarks, PersonDetector
from deblur_avatar.body_estimation.occluded_surface import occluded_fraction
from deblur_avatar.body_estimation.part_landmarks import detect_parts
from deblur_avatar.body_estimation.person_choice import detect_main_person
from deblur_avatar.body_estimation.person_crops import person_crops
from deblur_avatar.body_estimation.pose_model import PoseModel
from deblur_avatar.body_estimation.swept_mattes import swept_mattes
from deblur_avatar.body_estimation.track_smoothness import measure_track
from deblur_avatar.body_estimation.trimming import trimmed, without_background
from deblur_avatar.body_estimation.unseen_frames import between_seen
from deblur_avatar.config.section import NonNegative, Params, Positive
from deblur_avatar.errors import ArtifactError
from deblur_avatar.frame_numbers import spans
from deblur_avatar.geometry.cameras import project
from deblur_avatar.imaging.backgrounds import BackgroundEstimator, BackgroundKind
from deblur_avatar.imaging.exposure import AveragingSpace, frames_before
from deblur_avatar.imaging.person_pictures import PersonPictures, person_pictures
from deblur_avatar.imaging.resampling import Crop, crop_and_scale
from deblur_avatar.imaging.straightening import straightened


class PreprocessParams(Params):
    """Masks, crops and poses from blurred frames."""

    # estimated_in_detail: by hands and face too, in any pose, and limbs keep their mattes where the
    # background has their colour (docs/decisions/0064, 0065 and 0073); crops hold mattes, too
    poses: Literal["given", "estimated", "estimated_in_detail"]
    # swept: estimated, and no longer than the moving body covered a pixel (docs/decisions/0032)
    masks: Literal["given", "estimated", "swept"]
    background: BackgroundKind  # how it is known what is behind the person
    # known: the poses come from several views, say, and tell how far joints are from the camera
    # better than the training camera can
    depth: Literal["known", "unknown"]
    pose_std_degrees: Positive  # how far the poses may be off: root mean square of a joint's angle
    margin: NonNegative  # of the crop, as a share of the person's box
    validation_stride: Annotated[int, Field(ge=2)]  # every n-th frame is set aside

    @property
    def in_detail(self) -> bool:
        """Whether poses are estimated as those of new clips are."""
        return self.poses == "estimated_in_detail"


logger = logging.getLogger(__name__)

FILLED = 128  # matte, of 255: a frame without a single pixel this full shows no person


@dataclass(frozen=True)
class Preprocessed:
    """What `preprocess` makes; `sharp` and `exact` only where the clip knows them."""

    blurred: Observations
    sharp: Observations | None
    exact: Observations | None
    metrics: dict[str, Any]

    def save(self, folder: Path) -> None:
        """Write `blurred`, `sharp` and `exact` below a folder; what is not known stays empty."""
        for name in ("blurred", "sharp", "exact"):
            observations: Observations | None = getattr(self, name)
            if observations is not None:
                observations.save(folder / name)
            else:
                shutil.rmtree(folder / name, ignore_errors=True)  # of a run that knew more
                (folder / name).mkdir(parents=True)


def preprocess(
    clip: BlurryClip,
    body: Body,
    params: PreprocessParams,
    *,
    image_height: int,
    detect: PersonDetector,
) -> Preprocessed:
    """Bring a blurred clip into the form that fitting sees.

    Frames no taller than `image_height` are kept whole, so that a clip made at the size wanted
    comes out unchanged; taller ones are cropped to the person's boxes over the whole clip and
    scaled down.

    Args:
        clip: as `blur` made it.
        body: whom to pose.
        params: of the scene.
        image_height: pixels, of the schedule.
        detect: asked only where masks or poses are to be estimated.

    Raises:
        ArtifactError: if given poses or masks are missing, or no frame shows a person.
    """
    clip = straightened(clip)
    row = clip.recorded.index(clip.train_camera)
    scenes = [BackgroundEstimator(frames) for frames in clip.frames]
    people, kind = cast(list[Landmarks], []), params.background
    if params.masks != "given" or params.poses != "given":
        found = _people(clip, params, detect)
        people, kind = without_background(
            clip.frames, row, kind, found, scenes, by_limbs=params.in_detail
        )
    mattes, sharp_mattes = _mattes(clip, row, params, kind, people, detect)
    shown = _frames_with_person(mattes, clip.frame_indices)
    track = _track(clip, body, params, people, shown)
    _check_in_front(clip.cameras, clip.train_camera, body, track.poses, shown)
    crops, cameras = _crops(clip, body, params, track.poses, mattes, image_height)
    background = scenes[row].background(kind, mattes)
    if params.masks == "swept":
        mattes = swept_mattes(mattes, clip, body, track.poses)
    width, height = cameras.sizes[clip.train_camera].tolist()

    def pictures(frames: Tensor, mattes: Tensor) -> PersonPictures:
        return person_pictures(
            frames, mattes, background,
            lambda images: crop_and_scale(images, crops[clip.train_camera], (width, height)),
            cast(AveragingSpace, clip.averaging_space),
        )  # fmt: skip

    taken = pictures(clip.frames[row], mattes)
    track = _without_lost(track, taken.mattes, clip.frame_indices)
    blurred = _observations(clip, body, params, track, taken, crops, cameras)
    sharp, exact = None, None
    if clip.sharp_frames is not None and sharp_mattes is not None:
        taken = pictures(clip.sharp_frames, sharp_mattes)
        sharp = replace(blurred, exposure=0.0, **taken._asdict())
        if clip.exact is not None:
            exact = replace(sharp, poses=_checked(clip.exact, "exact", body))
    return Preprocessed(blurred, sharp, exact, _metrics(blurred, shown, track))


def _crops(
    clip: BlurryClip,
    body: Body,
    params: PreprocessParams,
    poses: Poses,
    mattes: UInt8[Tensor, "F H W"],
    image_height: int,
) -> tuple[list[Crop], Cameras]:
    """Where the body goes, and in new clips where the training camera's mattes do."""
    held = {clip.train_camera: mattes} if params.in_detail else {}
    return person_crops(clip.cameras, body, poses, params.margin, image_height, held)


@dataclass(frozen=True)
class _Track:
    """One pose a frame, how far each is to be trusted, and how well they fit the pictures."""

    poses: Poses
    weights: Float[Tensor, " F"]
    fit: dict[str, Any]
    flags: dict[str, int]
    model: PoseModel | None  # that found the landmarks; None where poses were given
    parts: dict[str, float]  # share of the frames in which hands and face were found


def _observations(
    clip: BlurryClip,
    body: Body,
    params: PreprocessParams,
    track: _Track,
    pictures: PersonPictures,
    crops: list[Crop],
    cameras: Cameras,
) -> Observations:
    """The blurred pictures with all that is known of them."""
    train, validation = _split(clip, track.weights > 0, params.validation_stride)
    return Observations(
        **pictures._asdict(),
        cameras=cameras,
        crops=torch.tensor(crops, dtype=torch.float32),
        train_camera=clip.train_camera,
        body=body,
        poses=track.poses,
        weights=track.weights,
        frame_indices=clip.frame_indices,
        timestamps=clip.timestamps,
        exposure=clip.exposure,
        exposure_std=clip.exposure_std,
        averaging_space=clip.averaging_space,
        train=train,
        validation=validation,
        depth_known=params.depth == "known",
        pose_std=math.radians(params.pose_std_degrees),
        occluded_fraction=occluded_fraction(
            body, track.poses.at(list(train)), cameras, clip.train_camera
        ),
    )


def _track(
    clip: BlurryClip,
    body: Body,
    params: PreprocessParams,
    people: list[Landmarks],
    shown: Bool[Tensor, " F"],
) -> _Track:
    """The poses that came with the clip, or a body fitted to what detectors found."""
    if params.poses == "given":
        return _Track(_checked(clip.initial, "initial", body), shown.float(), {}, {}, None, {})
    if params.in_detail:
        people = [
            replace(person, parts=detect_parts(frames, person.points, person.visibility))
            for frames, person in zip(clip.frames, people, strict=True)
        ]
    cameras, recorded = clip.cameras, clip.recorded
    fitted = fit_body(body, cameras, recorded, people, clip.timestamps, any_pose=params.in_detail)
    fit = measure_fit(fitted, body, cameras, recorded, [person.mattes for person in people])
    trusted, poses = shown.float() * fitted.trust, fitted.poses
    if params.in_detail:
        poses = between_seen(poses, fitted.trust > 0, clip.timestamps)
    if people[0].model == "full":
        logger.warning(
            "poses come from the smaller pose model and are up to two fifths farther off than "
            "need be; `deblur-avatar setup`, with npm on the path, brings the larger one"
        )
    return _Track(poses, trusted, fit, fitted.flags, people[0].model, fitted.parts)


def _metrics(blurred: Observations, shown: Bool[Tensor, " F"], track: _Track) -> dict[str, Any]:
    """Numbers of frames, and how well and how evenly the poses fit."""
    smoothness = measure_track(blurred.body, track.poses, blurred.timestamps, blurred.weights > 0)
    if smoothness:
        logger.info(
            "fastest joint %.1f m/s; the step that stands out most is %.2f times those around it "
            "(%s, frame %d)",
            smoothness["fastest_m_s"],
            smoothness["speed_ratio"],
            smoothness["joint"],
            blurred.frame_indices[smoothness["step"]],
        )
    return {
        "frames": {
            "total": len(shown),
            "without_person": int((~shown).sum()),
            "train": len(blurred.train),
            "validation": len(blurred.validation),
        },
        "hidden": blurred.occluded_fraction,
        "pose_model": track.model,
        "fit": track.fit,
        "landmarks_found_wrong": track.flags,
        "track": smoothness,
        **({"parts_found": track.parts} if track.parts else {}),
    }


def _people(clip: BlurryClip, params: PreprocessParams, detect: PersonDetector) -> list[Landmarks]:
    """Whom a detector finds in each camera's frames, and what the user found instead."""
    if len(clip.recorded) > 1 or params.poses == "given":
        return [detect(frames) for frames in clip.frames]
    person, count = detect_main_person(clip.frames[0], detect)
    seen = (count, int(person.found.sum()), len(person.found))
    logger.info("people: %d; the one followed is found in %d of %d frames", *seen)
    if clip.landmarks is not None:
        points, visibility = clip.landmarks[0, ..., :2], clip.landmarks[0, ..., 2]
        world = None if person.world is None else person.world * person.found[:, None, None]
        found = (visibility > 0).any(1)
        person = replace(person, found=found, points=points, visibility=visibility, world=world)
    if params.masks == "given" and clip.mattes is not None:
        person = replace(person, mattes=clip.mattes[0])
    return [person]


def _mattes(
    clip: BlurryClip,
    row: int,
    params: PreprocessParams,
    kind: BackgroundKind,
    people: list[Landmarks],
    detect: PersonDetector,
) -> tuple[UInt8[Tensor, "F H W"], UInt8[Tensor, "F H W"] | None]:
    """Mattes of the training camera's blurred frames, and of its sharp ones where there are any."""
    if params.masks == "given":
        if clip.mattes is None:
            raise ArtifactError("the clip has no mattes; set preprocess.masks to estimated")
        return clip.mattes[row], clip.sharp_mattes
    if clip.sharp_frames is None:
        return people[row].mattes, None
    sharp = detect(clip.sharp_frames)
    background = BackgroundEstimator(clip.sharp_frames).background(kind, sharp.mattes)
    alone = trimmed(clip.sharp_frames, sharp, background, by_limbs=params.in_detail)
    return people[row].mattes, alone.mattes


def _checked(poses: Poses | None, name: str, body: Body) -> Poses:
    """Poses that a clip brought along, if they are this body's."""
    if poses is None:
        raise ArtifactError(f"the clip has no {name} poses; set preprocess.poses to estimated")
    wanted = (len(body.parents) - 1, body.shape_dirs.shape[2])
    found = (poses.body_pose.shape[1], len(poses.betas))
    if found != wanted:
        raise ArtifactError(
            f"{name} poses have {found[0]} joints and {found[1]} shape numbers, the body has "
            f"{wanted[0]} and {wanted[1]}; bake body and clip from the same parameters"
        )
    return poses


def _frames_with_person(
    mattes: UInt8[Tensor, "F H W"], numbers: Sequence[int]
) -> Bool[Tensor, " F"]:
    """Which blurred frames show someone; the sharp ones have no say in what is trained on."""
    shown = mattes.flatten(1).amax(1) >= FILLED
    if not shown.any():
        raise ArtifactError("no frame shows a person: every mask is black; check masks and videos")
    if not shown.all():
        missing = [numbers[index] for index in torch.nonzero(~shown).flatten().tolist()]
        logger.warning("%d frames without a person are skipped: %s", len(missing), spans(missing))
    return shown


def _without_lost(track: _Track, mattes: UInt8[Tensor, "F H W"], numbers: Sequence[int]) -> _Track:
    """Trust no frame whose matte lies outside the crop: it is of somebody else, or of nothing.

    Raises:
        ArtifactError: if no frame is left whose pose rests on something that was seen.
    """
    lost = (track.weights > 0) & (mattes.flatten(1).amax(1) == 0)
    if lost.any():
        named = [numbers[index] for index in torch.nonzero(lost).flatten().tolist()]
        logger.warning(
            "%d frames are skipped, whose masks show nobody where the body goes: %s",
            len(named), spans(named),
        )  # fmt: skip
    weights = torch.where(lost, 0.0, track.weights)
    if not (weights > 0).any():
        raise ArtifactError(
            "no frame has both a mask and a pose that rests on something seen; look at masks and "
            "keypoints"
        )
    return replace(track, weights=weights)


def _check_in_front(
    cameras: Cameras, camera: int, body: Body, poses: Poses, shown: Bool[Tensor, " F"]
) -> None:
    """Refuse a training camera that has the whole person behind it in every frame with one."""
    joints = posed(body, poses).joints
    _, depths = project(joints[shown], cameras.Ks[camera], cameras.viewmats[camera])
    if (depths <= 0).all():
        raise ArtifactError(
            f"camera {cameras.names[camera]}: the body is behind it in every frame, its nearest "
            f"joint {-float(depths.max()):.2f} m; check the extrinsics (world to camera, OpenCV: "
            "+Z forward) and the poses"
        )


def _split(
    clip: BlurryClip, fitted: Bool[Tensor, " F"], stride: int
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Positions to train and to validate on, of frames that can be; the latter every `stride`-th.

    Frames whose shutter was still open when the held-out part began belong to neither.
    """
    usable: tuple[int, ...] = tuple(range(len(fitted)))
    if clip.held_out_from < len(fitted):
        end = float(clip.timestamps[clip.held_out_from])
        usable = frames_before(clip.timestamps, clip.exposure, end)
    usable = tuple(index for index in usable if fitted[index])
    validation = tuple(index for index in usable if index % stride == stride // 2)
    return tuple(index for index in usable if index not in validation), validation
