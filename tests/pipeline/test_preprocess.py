import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed_joints, posed_vertices
from deblur_avatar.body_estimation import body_fit
from deblur_avatar.body_estimation.body_fit import BodyFit, fit_body
from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.body_estimation.part_landmarks import PartLandmarks
from deblur_avatar.body_estimation.person_crops import _filled_box, person_crops
from deblur_avatar.body_estimation.trimming import without_background
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import project
from deblur_avatar.imaging import matting
from deblur_avatar.imaging.matting import near_person
from deblur_avatar.imaging.resampling import crop_and_scale
from deblur_avatar.pipeline.preprocess import Preprocessed, PreprocessParams, preprocess
from tests.walking_person import (
    FPS,
    SIZE,
    detect_perfectly,
    parts_perfectly,
    ring_of_cameras,
    walking_poses,
)

FRAMES, TRAIN, RECORDED = 9, 1, (0, 1, 3)
CAMERAS = ring_of_cameras()
BACKGROUND, PERSON = (60, 80, 40), (210, 150, 90)


@pytest.fixture(scope="module")
def poses(body: Body) -> Poses:
    return walking_poses(body, FRAMES)


@pytest.fixture(scope="module")
def people(body: Body, poses: Poses) -> dict[int, Landmarks]:
    return {camera: detect_perfectly(body, poses, CAMERAS, camera) for camera in RECORDED}


@pytest.fixture(scope="module")
def clip(poses: Poses, people: dict[int, Landmarks]) -> BlurryClip:
    """Flat colours; the first pixel of each frame tells its camera, the second its number."""
    mattes = torch.stack([people[camera].mattes for camera in RECORDED])
    inside = (mattes > 0)[..., None]
    frames = torch.where(inside, torch.tensor(PERSON), torch.tensor(BACKGROUND)).to(torch.uint8)
    for row, camera in enumerate(RECORDED):
        frames[row, :, 0, 0, 0] = camera
    train = RECORDED.index(TRAIN)
    return BlurryClip(
        frames=frames,
        mattes=mattes,
        sharp_frames=frames[train] // 2,
        sharp_mattes=mattes[train],
        recorded=RECORDED,
        train_camera=TRAIN,
        cameras=CAMERAS,
        frame_indices=tuple(range(2, 2 + FRAMES)),
        timestamps=torch.arange(2, 2 + FRAMES) / FPS,
        exposure=3 / FPS,
        averaging_space="srgb",
        held_out_from=7,
        initial=poses,
        exact=dataclasses.replace(poses, transl=poses.transl + 1),
    )


def params(**changes: Any) -> PreprocessParams:
    given: dict[str, Any] = {
        "poses": "given",
        "depth": "unknown",
        "pose_std_degrees": 2.0,
        "masks": "given",
        "background": "none",
        "margin": 0.1,
        "validation_stride": 4,
    }
    return PreprocessParams(**{**given, **changes})


def nobody(frames: torch.Tensor) -> Landmarks:
    raise AssertionError("what is given is not to be detected")


def run(
    clip: BlurryClip,
    body: Body,
    detect: Callable[[torch.Tensor], Landmarks] = nobody,
    image_height: int = 1000,
    **changes: Any,
) -> Preprocessed:
    return preprocess(clip, body, params(**changes), image_height=image_height, detect=detect)


def test_a_clip_of_the_size_wanted_comes_out_unchanged(clip: BlurryClip, body: Body):
    made = run(clip, body, image_height=SIZE[1])
    row = RECORDED.index(TRAIN)
    assert torch.equal(made.blurred.frames, clip.frames[row])
    assert torch.equal(made.blurred.mattes, clip.mattes[row])
    assert torch.equal(made.blurred.cameras.Ks, CAMERAS.Ks)
    assert made.blurred.crops.tolist() == [[0, 0, *SIZE]] * 4
    assert made.blurred.frame_indices == clip.frame_indices
    assert made.blurred.exposure == clip.exposure


def test_observations_say_whether_their_poses_know_depth(clip: BlurryClip, body: Body):
    assert not run(clip, body).blurred.depth_known
    assert run(clip, body, depth="known").blurred.depth_known


def test_how_far_poses_may_be_off_is_what_the_scene_says(clip, body):
    assert run(clip, body, pose_std_degrees=3.0).blurred.pose_std == pytest.approx(
        0.05236, rel=1e-3
    )


def test_sharp_and_exact_observations_differ_in_frames_and_poses_alone(
    clip: BlurryClip, body: Body
):
    made = run(clip, body)
    assert made.sharp is not None
    assert made.exact is not None
    assert torch.equal(made.sharp.frames, clip.sharp_frames)
    assert torch.equal(made.sharp.poses.transl, clip.initial.transl)
    assert torch.equal(made.exact.frames, clip.sharp_frames)
    assert torch.equal(made.exact.poses.transl, clip.exact.transl)
    assert (made.sharp.exposure, made.exact.exposure) == (0.0, 0.0)
    for field in ("train", "validation", "cameras", "crops", "weights"):
        values = [getattr(kind, field) for kind in (made.blurred, made.sharp, made.exact)]
        assert all(value is values[0] for value in values)


def test_what_a_clip_does_not_know_is_not_made(clip: BlurryClip, body: Body, tmp_path: Path):
    whole = run(clip, body)
    whole.save(tmp_path)
    assert Observations.load(tmp_path / "exact").train == whole.blurred.train
    blurred_only = dataclasses.replace(clip, sharp_frames=None, sharp_mattes=None, exact=None)
    made = run(blurred_only, body)
    assert (made.sharp, made.exact) == (None, None)
    made.save(tmp_path)
    # Empty folders: DVC wants each of its outputs.
    assert {path.name for path in tmp_path.iterdir()} == {"blurred", "sharp", "exact"}
    assert not any([*(tmp_path / "sharp").iterdir(), *(tmp_path / "exact").iterdir()])


def test_large_frames_are_cropped_to_the_person_and_every_camera_with_them(
    clip: BlurryClip, body: Body, poses: Poses
):
    made = run(clip, body, image_height=40, margin=0.05)
    vertices = posed_vertices(body, poses.betas, poses.global_orient, poses.body_pose, poses.transl)
    for camera, size in enumerate(made.blurred.cameras.sizes.tolist()):
        x, y, width, height = made.blurred.crops[camera].int().tolist()
        assert size[1] == 40
        assert size[0] == pytest.approx(width * 40 / height, abs=0.5)
        lens = CAMERAS.Ks[camera], CAMERAS.viewmats[camera]
        pixels = project(vertices, *lens)[0]
        assert (pixels >= torch.tensor([x, y])).all()
        assert (pixels <= torch.tensor([x + width, y + height])).all()
        # The cropped camera sees the same points at the same places of its picture.
        cropped = made.blurred.cameras
        again = project(vertices, cropped.Ks[camera], cropped.viewmats[camera])[0]
        scale = torch.tensor([size[0] / width, size[1] / height])
        torch.testing.assert_close(again, (pixels - torch.tensor([x, y])) * scale)
    crop = tuple(made.blurred.crops[TRAIN].int().tolist())
    expected = crop_and_scale(
        clip.frames[RECORDED.index(TRAIN)], crop, made.blurred.frames.shape[2:0:-1]
    )
    assert torch.equal(made.blurred.frames, expected)


def bare_crop(clip: BlurryClip, body: Body) -> tuple[int, ...]:
    """Where the body alone goes, in a small picture without a margin."""
    return tuple(run(clip, body, image_height=40, margin=0.0).blurred.crops[TRAIN].int().tolist())


def with_mask(clip: BlurryClip, frames: list[int], rows: slice, columns: slice) -> BlurryClip:
    mattes = clip.mattes.clone()
    mattes[RECORDED.index(TRAIN), frames, rows, columns] = 255
    return dataclasses.replace(clip, mattes=mattes)


def test_what_stands_off_the_body_is_in_the_crop_of_the_camera_whose_mattes_show_it(
    clip: BlurryClip, body: Body, poses: Poses
):
    def crops(mattes: dict[int, torch.Tensor]) -> list[tuple[int, ...]]:
        return person_crops(CAMERAS, body, poses, 0.0, 40, mattes)[0]

    bare = crops({})
    x, y, width, height = bare[TRAIN]
    left, wide = x - 8, slice(x - 8, x + width // 2)
    assert left > 1
    skirt = with_mask(clip, [*range(2, 7)], slice(y + height // 2, y + height - 8), wide)
    held = crops({TRAIN: skirt.mattes[RECORDED.index(TRAIN)]})
    assert left - 3 <= held[TRAIN][0] < left
    assert held[TRAIN][0] + held[TRAIN][2] == x + width
    assert [crop for crop in held if crop != bare[held.index(crop)]] == [held[TRAIN]]
    assert crops({TRAIN: torch.zeros_like(skirt.mattes[0])}) == bare


@pytest.mark.parametrize("kind", ["estimated", "estimated_in_detail"])
def test_crops_hold_mattes_in_new_clips(
    clip: BlurryClip, body: Body, people: dict[int, Landmarks], monkeypatch, kind: str
):
    monkeypatch.setattr(body_fit, "COARSE_STEPS", 2)
    monkeypatch.setattr(body_fit, "FINE_STEPS", 1)
    held = []

    def crops(*words):
        held.append(words[-1])
        return person_crops(*words)

    monkeypatch.setattr("deblur_avatar.pipeline.preprocess.person_crops", crops)
    monkeypatch.setattr("deblur_avatar.pipeline.preprocess.detect_parts", lambda *_: None)
    own = of_one_camera(clip, mattes=people[TRAIN].mattes[None])
    run(own, body, OneCamera(people[TRAIN]), poses=kind, masks="given")
    assert list(held[0]) == ([TRAIN] if kind == "estimated_in_detail" else [])


def test_a_mask_that_strays_for_a_moment_widens_no_crop_of_a_long_clip():
    mattes = torch.zeros(100, 30, 60, dtype=torch.uint8)
    mattes[:, 10:20, 25:35] = 255
    mattes[41, 10:20, 55:60] = 255
    mattes[50:60] = 0  # frames without a person have no say
    torch.testing.assert_close(_filled_box(mattes), torch.tensor([[25.0, 10, 35, 20]]))
    assert _filled_box(mattes[50:60]) is None


def test_a_frame_whose_mask_lies_outside_the_crop_is_skipped_and_named(
    clip: BlurryClip, body: Body, caplog: pytest.LogCaptureFixture
):
    x, *_ = bare_crop(clip, body)
    mattes = clip.mattes.clone()
    mattes[RECORDED.index(TRAIN), 3] = 0
    strayed = dataclasses.replace(clip, mattes=mattes)
    strayed = with_mask(strayed, [3], slice(0, 20), slice(0, x - 2))
    made = run(strayed, body, image_height=40, margin=0.0).blurred
    assert made.weights.tolist() == [1, 1, 1, 0, 1, 1, 1, 1, 1]
    assert made.train == (0, 1, 4, 5)
    assert "masks show nobody where the body goes: 5" in caplog.text
    mattes[RECORDED.index(TRAIN)] = 0
    mattes[RECORDED.index(TRAIN), :, :20, : x - 2] = 255
    with pytest.raises(ArtifactError, match="no frame has both a mask and a pose"):
        run(dataclasses.replace(clip, mattes=mattes), body, image_height=40, margin=0.0)


def test_frames_are_never_scaled_up(clip: BlurryClip, body: Body):
    made = run(clip, body, image_height=SIZE[1] - 1, margin=0.0)
    assert made.blurred.crops[TRAIN, 3] < SIZE[1] - 1
    assert made.blurred.cameras.sizes[TRAIN].tolist() == made.blurred.crops[TRAIN, 2:].tolist()


def test_training_frames_end_before_the_shutter_opens_on_the_held_out_part(
    clip: BlurryClip, body: Body
):
    made = run(clip, body).blurred
    # Frame 7 is the first held out; frame 6 is open until half way to 7.5, frame 5 until 6.5.
    assert made.validation == (2,)
    assert made.train == (0, 1, 3, 4, 5)
    instant = run(dataclasses.replace(clip, exposure=None), body).blurred
    assert instant.train == (0, 1, 3, 4, 5)
    assert instant.validation == (2, 6)


def test_a_black_matte_sets_its_frame_aside_with_a_warning(
    clip: BlurryClip, body: Body, caplog: pytest.LogCaptureFixture
):
    mattes = clip.mattes.clone()
    mattes[RECORDED.index(TRAIN), 3] = 0
    mattes[0, 4] = 0  # not the training camera
    made = run(dataclasses.replace(clip, mattes=mattes), body)
    assert made.blurred.train == (0, 1, 4, 5)
    assert made.blurred.weights.tolist() == [1, 1, 1, 0, 1, 1, 1, 1, 1]
    assert made.metrics["frames"] == {
        "total": 9, "without_person": 1, "train": 4, "validation": 1,
    }  # fmt: skip
    assert "1 frames without a person are skipped: 5" in caplog.text


def test_a_clip_of_black_mattes_is_refused(clip: BlurryClip, body: Body):
    black = dataclasses.replace(clip, mattes=torch.zeros_like(clip.mattes))
    with pytest.raises(ArtifactError, match="every mask is black"):
        run(black, body)


def test_what_was_promised_must_be_there(clip: BlurryClip, body: Body):
    with pytest.raises(ArtifactError, match="no initial poses; set preprocess.poses to estimated"):
        run(dataclasses.replace(clip, initial=None), body)
    with pytest.raises(ArtifactError, match="no mattes; set preprocess.masks to estimated"):
        run(dataclasses.replace(clip, mattes=None), body)
    short = dataclasses.replace(clip.initial, betas=torch.zeros(7))
    with pytest.raises(ArtifactError, match="initial poses have 23 joints and 7 shape numbers"):
        run(dataclasses.replace(clip, initial=short), body)


def test_a_person_outside_the_picture_is_refused(clip: BlurryClip, body: Body):
    away = dataclasses.replace(
        clip.initial, transl=clip.initial.transl + torch.tensor([0.0, 20.0, 0.0])
    )
    with pytest.raises(ArtifactError, match="camera cam.*check the calibration"):
        run(dataclasses.replace(clip, initial=away), body, image_height=40)


def test_a_person_behind_the_training_camera_is_refused(clip: BlurryClip, body: Body):
    viewmats = CAMERAS.viewmats.clone()
    viewmats[TRAIN, 2, 3] *= -1
    behind = dataclasses.replace(clip, cameras=dataclasses.replace(CAMERAS, viewmats=viewmats))
    with pytest.raises(ArtifactError, match="the body is behind it in every frame"):
        run(behind, body)


def test_distortion_is_taken_out_once(clip: BlurryClip, body: Body):
    lens = torch.tensor([-0.2, 0.05, 0.0, 0.0, 0.0]).repeat(4, 1)
    bent = dataclasses.replace(clip, cameras=dataclasses.replace(CAMERAS, distortion=lens))
    made = run(bent, body)
    assert not made.blurred.cameras.distortion.any()
    assert made.sharp is not None
    row = RECORDED.index(TRAIN)
    changed = (made.blurred.mattes != clip.mattes[row]).float().mean()
    assert 0.002 < changed < 0.2
    # Frame and matte were bent alike: the person's colour is where her matte is.
    inside = made.blurred.mattes == 255
    assert (made.blurred.frames[inside] == torch.tensor(PERSON)).float().mean() > 0.98


class Detector:
    """Finds in each frame what is truly there, by the camera's mark in its first pixel."""

    def __init__(self, people: dict[int, Landmarks]) -> None:
        self.people = people

    def __call__(self, frames: torch.Tensor) -> Landmarks:
        mark = int(frames[0, 0, 0, 0])
        return self.people[TRAIN if mark == TRAIN // 2 and frames[0, 5, 5, 0] < 50 else mark]


def test_masks_and_poses_are_estimated_where_they_are_not_given(
    clip: BlurryClip,
    body: Body,
    poses: Poses,
    people: dict[int, Landmarks],
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr(body_fit, "COARSE_STEPS", 80)
    monkeypatch.setattr(body_fit, "FINE_STEPS", 40)
    unknown = dataclasses.replace(clip, mattes=None, sharp_mattes=None, initial=None, exact=None)
    made = run(
        unknown, body, Detector(people), poses="estimated", masks="estimated", background="median"
    )
    found = made.blurred.poses
    joints = [
        posed_joints(body, p.betas, p.global_orient, p.body_pose, p.transl) for p in (found, poses)
    ]
    assert (joints[0] - joints[1]).norm(dim=-1).mean() < 0.03
    assert made.exact is None
    assert made.sharp is not None
    assert set(made.metrics["fit"]) == {"cam0", "cam1", "cam3"}
    assert made.metrics["fit"]["cam1"]["iou"] > 0.75
    # The person stands before the background that frames have in common.
    assert made.blurred.backgrounds is not None
    assert len(made.blurred.backgrounds) == 1
    behind = made.blurred.backgrounds.expand_as(made.blurred.frames)
    outside = ~near_person(made.blurred.mattes > 0)
    assert behind.max() > 0
    assert torch.equal(made.blurred.frames[outside], behind[outside])
    assert torch.equal(made.sharp.backgrounds, made.blurred.backgrounds)
    assert (made.blurred.frames[made.blurred.mattes == 255] == torch.tensor(PERSON)).all()


def of_one_camera(clip: BlurryClip, **changes: Any) -> BlurryClip:
    """What a user's own video gives: one camera, blurred, nothing known."""
    row = RECORDED.index(TRAIN)
    nothing = {"sharp_frames": None, "sharp_mattes": None, "initial": None, "exact": None}
    own = {"frames": clip.frames[row : row + 1], "mattes": None, "recorded": (TRAIN,)}
    return dataclasses.replace(clip, **{**own, **nothing, **changes})


class OneCamera:
    """Finds the person of the training camera, until she is hidden."""

    def __init__(self, person: Landmarks) -> None:
        self.person = person

    def __call__(self, frames: torch.Tensor) -> Landmarks:
        if (frames[0] == torch.tensor(PERSON, dtype=torch.uint8)).all(-1).any():
            return self.person
        none = torch.zeros(len(frames), dtype=torch.bool)
        first = slice(0, len(frames))
        points, seen = self.person.points[first], self.person.visibility[first]
        return Landmarks(none, 0 * points, 0 * seen, torch.zeros_like(self.person.mattes[first]))


def test_one_view_is_enough_and_says_how_its_track_moves(
    clip: BlurryClip, body: Body, people: dict[int, Landmarks], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(body_fit, "COARSE_STEPS", 60)
    monkeypatch.setattr(body_fit, "FINE_STEPS", 20)
    visibility = people[TRAIN].visibility.clone()
    visibility[4] *= 0.2
    person = dataclasses.replace(people[TRAIN], visibility=visibility)
    made = run(
        of_one_camera(clip), body, OneCamera(person), poses="estimated", masks="estimated",
        background="auto",
    )  # fmt: skip
    assert made.sharp is None
    assert made.blurred.weights.argmin() == 4
    assert made.blurred.weights[[0, 1, 2, 3, 5, 6, 7, 8]].min() == 1
    assert made.metrics["landmarks_found_wrong"]["lost"] > 20
    assert made.metrics["track"]["speed_ratio"] < 3
    assert set(made.metrics["track"]["by_joint"]) == set(body.joint_names)


@pytest.mark.parametrize("model", ["heavy", "full"])
def test_poses_say_which_pose_model_they_come_from(
    clip: BlurryClip, body: Body, people: dict[int, Landmarks], monkeypatch, caplog, model
):
    monkeypatch.setattr(body_fit, "COARSE_STEPS", 2)
    monkeypatch.setattr(body_fit, "FINE_STEPS", 1)
    person = dataclasses.replace(people[TRAIN], model=model)
    made = run(of_one_camera(clip), body, OneCamera(person), poses="estimated", masks="estimated")
    assert made.metrics["pose_model"] == model
    assert ("the smaller pose model" in caplog.text) == (model == "full")
    assert ("deblur-avatar setup" in caplog.text) == (model == "full")


@pytest.mark.parametrize("cameras", ["one", "several"])
def test_hands_and_face_are_looked_for_where_asked(
    clip: BlurryClip, body: Body, people: dict[int, Landmarks], poses: Poses, monkeypatch, cameras
):
    monkeypatch.setattr(body_fit, "COARSE_STEPS", 2)
    monkeypatch.setattr(body_fit, "FINE_STEPS", 1)
    looked = []

    def looking(
        frames: torch.Tensor, points: torch.Tensor, visibility: torch.Tensor
    ) -> PartLandmarks:
        camera = int(frames[0, 0, 0, 0])
        looked.append(camera)
        assert torch.equal(points, people[camera].points)
        assert torch.equal(visibility, people[camera].visibility)
        parts = parts_perfectly(body, poses, CAMERAS, camera)
        return dataclasses.replace(parts, face_found=torch.arange(FRAMES) < 3)

    fitted, poses_asked = fit_body, []

    def fitting(*given: object, any_pose: bool, **named: object) -> BodyFit:
        poses_asked.append(any_pose)
        return fitted(*given, any_pose=any_pose, **named)

    trimmed_by_limbs = []

    def trimming(*given: object, by_limbs: bool) -> object:
        trimmed_by_limbs.append(by_limbs)
        return without_background(*given, by_limbs=by_limbs)

    monkeypatch.setattr("deblur_avatar.pipeline.preprocess.without_background", trimming)
    monkeypatch.setattr("deblur_avatar.pipeline.preprocess.detect_parts", looking)
    monkeypatch.setattr("deblur_avatar.pipeline.preprocess.fit_body", fitting)
    alone = cameras == "one"
    filmed = of_one_camera(clip) if alone else clip

    def made(kind: str) -> Preprocessed:
        detect = OneCamera(people[TRAIN]) if alone else Detector(people)
        return run(filmed, body, detect, poses=kind, masks="estimated")

    plain = made("estimated")
    assert looked == []
    assert "parts_found" not in plain.metrics
    detailed = made("estimated_in_detail")
    assert looked == ([TRAIN] if alone else list(RECORDED))
    assert poses_asked == [False, True]
    assert trimmed_by_limbs == [False, True]
    found = {"left_hand": 1.0, "right_hand": 1.0, "face": 3 / FRAMES}
    assert detailed.metrics["parts_found"] == pytest.approx(found)
    wrist = SMPL_JOINT_NAMES.index("left_wrist") - 1
    apart = (detailed.blurred.poses.body_pose - plain.blurred.poses.body_pose)[:, wrist]
    assert apart.abs().max() > 1e-4


@pytest.mark.parametrize("cameras", ["one", "several"])
def test_poses_of_frames_in_which_nobody_is_seen_lie_between_where_asked(
    clip: BlurryClip, body: Body, people: dict[int, Landmarks], poses: Poses, monkeypatch, cameras
):
    monkeypatch.setattr(body_fit, "COARSE_STEPS", 60)
    monkeypatch.setattr(body_fit, "FINE_STEPS", 1)
    monkeypatch.setattr("deblur_avatar.body_estimation.unseen_frames.EASE_S", 1e-3)
    monkeypatch.setattr(
        "deblur_avatar.pipeline.preprocess.detect_parts",
        lambda *_: parts_perfectly(body, poses, CAMERAS, TRAIN),
    )
    gone, alone = torch.isin(torch.arange(FRAMES), torch.tensor([3, 4, 5])), cameras == "one"
    seen = people[TRAIN]
    person = dataclasses.replace(
        seen, found=~gone, visibility=seen.visibility * ~gone[:, None],
        mattes=torch.where(gone[:, None, None], 0, seen.mattes),
    )  # fmt: skip
    filmed = of_one_camera(clip) if alone else clip
    for kind in ("estimated", "estimated_in_detail"):
        detect = OneCamera(person) if alone else Detector(people | {TRAIN: person})
        made = run(filmed, body, detect, poses=kind, masks="estimated")
        assert (made.blurred.weights[gone] == 0).all()
        transl = made.blurred.poses.transl
        middle = (transl[2] + transl[6]) / 2
        # Another camera that saw her told the pose.
        is_even = alone and kind == "estimated_in_detail"
        assert torch.allclose(transl[4], middle, atol=1e-5) == is_even


def test_given_poses_come_from_no_pose_model(clip: BlurryClip, body: Body):
    assert run(clip, body).metrics["pose_model"] is None


def test_keypoints_and_masks_of_the_user_s_own_are_preferred(
    clip: BlurryClip, body: Body, people: dict[int, Landmarks], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(body_fit, "COARSE_STEPS", 60)
    monkeypatch.setattr(body_fit, "FINE_STEPS", 1)
    true = people[TRAIN]
    brought = torch.cat([true.points, true.visibility[..., None]], dim=-1)[None]
    own = of_one_camera(clip, landmarks=brought, mattes=true.mattes[None])
    wrong = dataclasses.replace(true, points=true.points + 30, mattes=255 - true.mattes)
    made = run(own, body, OneCamera(wrong), poses="estimated", masks="given")
    assert torch.equal(made.blurred.mattes, true.mattes)
    assert made.metrics["fit"]["cam1"]["reprojection_px"] < 3


def test_frames_whose_pose_rests_on_nothing_are_in_no_set_though_they_have_a_mask(
    clip: BlurryClip, body: Body, people: dict[int, Landmarks], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(body_fit, "COARSE_STEPS", 20)
    monkeypatch.setattr(body_fit, "FINE_STEPS", 1)
    seen = people[TRAIN]
    missed = dataclasses.replace(
        seen, found=~torch.isin(torch.arange(FRAMES), torch.tensor([2, 3]))
    )
    own = of_one_camera(clip, mattes=seen.mattes[None])
    made = run(own, body, OneCamera(missed), poses="estimated", masks="given").blurred
    assert (made.weights[[2, 3]] == 0).all()
    assert not {2, 3} & {*made.train, *made.validation}


def test_sharp_mattes_have_no_say_in_what_is_trained_on(body: Body, clip: BlurryClip):
    sharp_mattes = clip.sharp_mattes.clone()
    sharp_mattes[0] = 0
    changed = dataclasses.replace(clip, sharp_mattes=sharp_mattes)
    sets = [
        preprocess(each, body, params(), image_height=SIZE[1], detect=nobody).blurred
        for each in (clip, changed)
    ]
    assert sets[0].train == sets[1].train
    assert sets[0].validation == sets[1].validation
    assert torch.equal(sets[0].weights, sets[1].weights)


@pytest.mark.parametrize("background", ["none", "matte", "median", "changing light"])
def test_pictures_are_the_same_however_many_frames_are_made_at_once(
    body: Body, clip: BlurryClip, monkeypatch: pytest.MonkeyPatch, background: str
):
    if background == "changing light":
        gain = torch.linspace(0.7, 1.2, FRAMES)[None, :, None, None, None]
        frames = (clip.frames * gain).round().to(torch.uint8)
        clip, background = dataclasses.replace(clip, frames=frames), "median"
        assert preprocess_backgrounds(clip, body) == FRAMES
    wanted = run(clip, body, image_height=SIZE[1] // 2, background=background).blurred
    monkeypatch.setattr(matting, "FRAMES_AT_ONCE", 2)
    made = run(clip, body, image_height=SIZE[1] // 2, background=background).blurred
    assert torch.equal(made.frames, wanted.frames)
    for name in ("comparable", "backgrounds"):
        one, other = getattr(made, name), getattr(wanted, name)
        assert (one is None) == (other is None)
        assert one is None or torch.equal(one, other)
    assert (wanted.backgrounds is None) == (background in ("none", "matte"))


def preprocess_backgrounds(clip: BlurryClip, body: Body) -> int:
    """How many backgrounds frames are shown before."""
    behind = run(clip, body, background="median").blurred.backgrounds
    assert behind is not None
    return len(behind)
