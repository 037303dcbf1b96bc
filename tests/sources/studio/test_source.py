import dataclasses

import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.errors import ConfigError
from deblur_avatar.imaging.color import linear_to_srgb
from deblur_avatar.rendering.mesh_rendering import (
    Picture,
    View,
    render,
)
from deblur_avatar.sources.studio.motion import move
from deblur_avatar.sources.studio.person import create_person
from deblur_avatar.sources.studio.source import (
    LIGHTING,
    SUBFRAMES,
    StudioParams,
    encode,
    load_studio,
)

TINY = StudioParams(
    source="studio",
    motion="turn",
    frames=8,
    fps=60.0,
    image_size=16,
    test_cameras=3,
    test_stride=2,
    window=9,
    samples_per_axis=2,
    noise_degrees=1.5,
    noise_mm=5.0,
    noise_correlation_s=0.1,
    held_out=0.25,
)


def filmed(body: Body, **changes: object) -> tuple[Clip, Reference]:
    return load_studio(TINY.model_copy(update=changes), body, torch.Generator().manual_seed(0))


@pytest.fixture(scope="module")
def turning(body: Body) -> tuple[Clip, Reference]:
    return filmed(body)


@pytest.fixture(scope="module")
def standing(body: Body) -> tuple[Clip, Reference]:
    return filmed(body, motion="still", noise_degrees=0.0, noise_mm=0.0)


def test_every_field_is_filled_but_landmarks(turning: tuple[Clip, Reference]):
    for artifact in turning:
        for field in dataclasses.fields(artifact):
            if field.name in (
                "landmarks", "offsets", "viewmats", "filmed", "exposure_std", "numbers",
            ):  # fmt: skip
                continue  # poses and exposure are known, nothing else was estimated
            assert getattr(artifact, field.name) is not None, field.name


def test_frames_have_the_size_and_number_asked_for(turning: tuple[Clip, Reference]):
    clip, reference = turning
    assert clip.frames.shape == (1, 8, 16, 16, 3)
    assert clip.held_out_from == 6
    assert clip.frame_indices == tuple(range(1, 7))  # 4 sub-frames on either side
    assert clip.true_blur_exposure == pytest.approx(9 / 480)
    assert clip.exposure == 0
    assert len(reference.motion_times) == 7 * SUBFRAMES + 1
    torch.testing.assert_close(reference.motion_times[::SUBFRAMES], clip.timestamps)


def test_the_person_fills_the_picture_over_black(turning: tuple[Clip, Reference]):
    clip, _ = turning
    rows = clip.mattes[0].amax((0, 2)) > 0
    assert 0.7 <= rows.float().mean() < 1
    assert (clip.frames[clip.mattes == 0] == 0).all()
    assert clip.frames[clip.mattes == 255].float().mean() > 30


def test_a_still_body_does_not_blur(standing: tuple[Clip, Reference]):
    clip, _ = standing
    sharp = clip.frames[0][list(clip.frame_indices)]
    for blur in (clip.true_blur_srgb, clip.true_blur_linear):
        assert (blur.int() - sharp.int()).abs().max() <= 1
    assert torch.equal(clip.true_blur_mattes, clip.mattes[0][list(clip.frame_indices)])


def test_without_noise_the_first_poses_are_the_truth(standing: tuple[Clip, Reference]):
    clip, reference = standing
    for name in ("betas", "global_orient", "body_pose", "transl"):
        assert torch.equal(getattr(clip.initial, name), getattr(clip.exact, name))
    assert (clip.exact.betas != 0).any()
    torch.testing.assert_close(reference.motion.transl[::SUBFRAMES], clip.exact.transl)


def test_with_noise_they_are_not(turning: tuple[Clip, Reference]):
    clip, _ = turning
    assert 0.001 < (clip.initial.body_pose - clip.exact.body_pose).abs().mean() < 0.1
    assert torch.equal(clip.initial.betas, clip.exact.betas)


def test_a_fast_body_does_and_light_adds_up_brighter_than_srgb(turning: tuple[Clip, Reference]):
    clip, _ = turning
    sharp = clip.frames[0][list(clip.frame_indices)].float()
    assert (clip.true_blur_linear.float() - sharp).abs().mean() > 1
    # The mean of light is never darker than the mean of its sRGB codes.
    assert (clip.true_blur_linear.int() - clip.true_blur_srgb.int()).min() >= -1
    assert (clip.true_blur_linear.int() - clip.true_blur_srgb.int()).max() > 5


def test_blur_is_the_mean_of_what_the_eye_sees_while_the_shutter_is_open(
    body: Body, turning: tuple[Clip, Reference]
):
    clip, _ = turning
    person = create_person(body, clip.exact.betas)
    view = View.of(clip.cameras, 0, TINY.samples_per_axis)
    times = (2 * SUBFRAMES + torch.arange(-4, 5)) / (SUBFRAMES * TINY.fps)
    shown = person.posed(move("turn", times, 6 / TINY.fps))
    instants = np.stack([render(v, person.mesh, view, LIGHTING).light for v in shown])
    index = clip.frame_indices.index(2)
    in_light = linear_to_srgb(torch.from_numpy(instants.mean(0))) * 255
    assert (clip.true_blur_linear[index] - in_light).abs().max() < 1.5
    in_srgb = linear_to_srgb(torch.from_numpy(instants)).mean(0) * 255
    assert (clip.true_blur_srgb[index] - in_srgb).abs().max() < 1.0


def test_test_views_are_of_other_cameras_and_of_both_splits(turning: tuple[Clip, Reference]):
    _, reference = turning
    assert set(reference.camera_indices.tolist()) == {1, 2, 3}
    # Trained: 1 to 5 (frame 5's shutter closes before frame 6's middle); held out: 6.
    views = list(zip(reference.frame_indices.tolist(), reference.novel_pose.tolist(), strict=True))
    assert views == 3 * [(1, 0), (3, 0), (5, 0), (6, 1)]
    assert reference.background == (0.0, 0.0, 0.0)


def test_frames_that_see_the_held_out_part_are_not_trained_on(body: Body):
    _, reference = filmed(body, window=17)
    # The shutter of frame 5 closes 8.5 sub-frames after its middle, half a one after frame 6's.
    assert reference.frame_indices[:3].tolist() == [1, 3, 6]


def test_seen_pixels_lie_on_the_person_and_are_many(turning: tuple[Clip, Reference]):
    _, reference = turning
    seen = reference.seen == 255
    assert ((reference.seen == 0) | seen).all()
    assert not seen[reference.mattes == 0].any()
    assert seen[reference.mattes == 255].float().mean() > 0.6


def test_a_person_who_never_turns_hides_her_back(standing: tuple[Clip, Reference]):
    _, reference = standing
    shares = [
        (reference.seen[view] == 255)[reference.mattes[view] == 255].float().mean()
        for view in (reference.camera_indices == index for index in (1, 2, 3))
    ]
    # She looks 23 degrees to the left of the training camera; 1 and 3 stand 120 degrees away.
    assert max(shares) < 0.6


def test_the_same_seed_films_the_same_clip(body: Body, turning: tuple[Clip, Reference]):
    clip, reference = filmed(body)
    assert torch.equal(clip.frames, turning[0].frames)
    assert torch.equal(clip.initial.body_pose, turning[0].initial.body_pose)
    assert torch.equal(clip.true_blur_linear, turning[0].true_blur_linear)
    assert torch.equal(reference.seen, turning[1].seen)


def test_a_window_longer_than_the_clip_is_refused(body: Body):
    with pytest.raises(ConfigError, match="no frame is left for training: 8 frames"):
        filmed(body, window=129)


def test_an_even_window_is_refused(body: Body):
    with pytest.raises(ConfigError, match=r"clip\.window: .*odd, got 8"):
        filmed(body, window=8)


def test_an_unknown_motion_is_refused(body: Body):
    with pytest.raises(ConfigError, match="no motion 'fly'"):
        filmed(body, motion="fly")


def test_pictures_are_coded_as_srgb_with_coverage_as_it_is():
    light = np.full((1, 1, 3), 0.5, np.float32)
    coded = encode(Picture(light, np.full((1, 1), 0.5, np.float32)))
    assert coded[0, 0].tolist() == [188, 188, 188, 128]  # half the light of white is sRGB 188
