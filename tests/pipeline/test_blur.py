import dataclasses

import cv2
import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.errors import ConfigError
from deblur_avatar.imaging.exposure import frames_before
from deblur_avatar.pipeline.blur import BlurParams, blur

FRAMES, HEIGHT, WIDTH, FPS = 12, 36, 48, 60.0
PLAIN = BlurParams(frames="interpolated", factor=4, window=9, light="srgb")


def picture(time: float) -> np.ndarray:
    """A soft bright ball with its matte, at `time` frames; it moves 2 pixels a frame."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    squared = (columns - 10 - 2 * time) ** 2 + (rows - 18) ** 2
    alpha = np.exp(-squared / 50)[..., None]
    front = np.stack([230 + 0 * rows, 120 + 3 * rows, 40 + 4 * rows], -1)
    return np.rint(np.concatenate([alpha * front, 255 * alpha], -1)).astype(np.uint8)


def make_clip(true_window: int = 9, recorded: tuple[int, ...] = (1,)) -> Clip:
    """Camera 1 trains; the true blur is of `true_window` quarter frames."""
    stack = torch.from_numpy(np.stack([picture(frame) for frame in range(FRAMES)]))
    half = true_window // 2
    reach = -(-half // 4)
    kept = tuple(range(reach, FRAMES - reach))
    sums = [
        np.mean([picture(frame + step / 4) for step in range(-half, half + 1)], 0) for frame in kept
    ]
    true = torch.from_numpy(np.rint(sums).astype(np.uint8))
    K = torch.tensor([[50.0, 0, 24], [0, 50, 18], [0, 0, 1]])
    cameras = Cameras(
        Ks=K.expand(3, 3, 3).clone(),
        viewmats=torch.eye(4).expand(3, 4, 4).clone(),
        distortion=torch.zeros(3, 5),
        sizes=torch.tensor([[WIDTH, HEIGHT]] * 3),
        names=("one", "two", "three"),
    )
    poses = Poses(
        betas=torch.zeros(2),
        global_orient=torch.zeros(FRAMES, 3),
        body_pose=torch.zeros(FRAMES, 3, 3),
        transl=torch.arange(FRAMES)[:, None].expand(FRAMES, 3).float(),
    )
    return Clip(
        frames=stack[..., :3].expand(len(recorded), -1, -1, -1, -1).contiguous(),
        mattes=stack[..., 3].expand(len(recorded), -1, -1, -1).contiguous(),
        recorded=recorded,
        train_camera=1,
        cameras=cameras,
        timestamps=torch.arange(FRAMES) / FPS,
        blurred=False,
        exposure=None,
        light="srgb",
        held_out_from=9,
        initial=poses,
        exact=None,
        true_blur_srgb=true[..., :3].contiguous(),
        true_blur_linear=None,
        true_blur_mattes=true[..., 3].contiguous(),
        frame_indices=kept,
        true_blur_exposure=true_window / (4 * FPS),
    )


def changed(params: BlurParams, **values: object) -> BlurParams:
    return BlurParams(**{**params.model_dump(), **values})


def test_frames_are_the_mean_of_the_light_that_fell_while_the_shutter_was_open():
    clip = make_clip()
    blurry, measured = blur(clip, PLAIN)
    assert blurry.frame_indices == tuple(range(1, 11))
    error = (blurry.frames[0].int() - clip.true_blur_srgb.int()).abs()
    assert error.max() <= 6
    assert (blurry.mattes[0].int() - clip.true_blur_mattes.int()).abs().max() <= 6
    sharp_error = (blurry.sharp_frames.int() - clip.true_blur_srgb.int()).abs()
    assert sharp_error.max() > 3 * error.max()
    assert measured["blur"]["psnr"] > 45
    assert measured["interpolation"]["psnr"] > measured["interpolation"]["psnr_plain"] + 5
    assert measured["frames"] == {"clip": 12, "kept": 10, "dropped": 2, "held_out": 2}


def test_all_that_belongs_to_a_frame_stays_with_it():
    clip = make_clip()
    blurry, _ = blur(clip, PLAIN)
    kept = list(blurry.frame_indices)
    assert torch.equal(blurry.timestamps, clip.timestamps[kept])
    assert torch.equal(blurry.sharp_frames, clip.frames[0, kept])
    assert torch.equal(blurry.sharp_mattes, clip.mattes[0, kept])
    assert blurry.initial.transl[:, 0].tolist() == kept
    assert blurry.frame_indices[blurry.held_out_from] == clip.held_out_from
    assert blurry.exposure == pytest.approx(9 / 240)
    assert blurry.exact is None


def test_training_frames_can_be_told_from_those_that_see_the_held_out_part():
    blurry, _ = blur(make_clip(), PLAIN)
    begin = float(blurry.timestamps[blurry.held_out_from])
    before = frames_before(blurry.timestamps, blurry.exposure, begin)
    # Frame 8's window ends one quarter after frame 9 began; frame 7's just touches frame 8.
    assert [blurry.frame_indices[index] for index in before] == [1, 2, 3, 4, 5, 6, 7]


def test_every_recorded_camera_is_blurred_alike():
    blurry, _ = blur(make_clip(recorded=(0, 1)), PLAIN)
    single, _ = blur(make_clip(), PLAIN)
    assert torch.equal(blurry.frames[0], single.frames[0])
    assert torch.equal(blurry.frames[1], single.frames[0])


def test_linear_light_is_brighter_where_bright_and_dark_mix():
    clip = make_clip()
    in_srgb, _ = blur(clip, PLAIN)
    in_linear, _ = blur(clip, changed(PLAIN, light="linear"))
    assert in_linear.light == "linear"
    assert in_linear.frames.double().mean() > in_srgb.frames.double().mean() + 0.2
    assert torch.equal(in_linear.mattes, in_srgb.mattes)


def test_the_physically_true_blur_is_taken_as_it_is():
    clip = make_clip()
    blurry, measured = blur(clip, changed(PLAIN, frames="true"))
    assert torch.equal(blurry.frames[0], clip.true_blur_srgb)
    assert torch.equal(blurry.mattes[0], clip.true_blur_mattes)
    assert measured["source"] == "true"


def test_a_window_of_one_gives_the_sharp_frames():
    clip = make_clip()
    blurry, measured = blur(clip, changed(PLAIN, window=1))
    assert torch.equal(blurry.frames, clip.frames)
    assert measured["blur"] is None


def test_true_blur_of_another_window_measures_nothing():
    blurry, measured = blur(make_clip(), changed(PLAIN, window=7))
    assert blurry.frame_indices == make_clip().frame_indices
    assert measured["blur"] is None


def test_a_clip_that_is_blurred_already_passes_through():
    clip = dataclasses.replace(make_clip(), blurred=True, exposure=0.02, light="linear")
    blurry, measured = blur(clip, PLAIN)
    assert torch.equal(blurry.frames, clip.frames)
    assert blurry.exposure == 0.02
    assert blurry.light == "linear"
    assert blurry.sharp_frames is None
    assert measured["frames"]["dropped"] == 0


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"window": 8}, "a window centred on a frame is odd, got 8"),
        ({"window": 45}, "45 sub-frames, 4 a frame, leave no training frame of a clip of 12"),
        ({"frames": "true", "light": "linear"}, "no true blur in linear light"),
        ({"frames": "true", "window": 11}, "true blur is of 37.50 ms, .* ask for 45.83 ms"),
        ({"frames": "true", "window": 7}, "true blur is of 37.50 ms, .* ask for 29.17 ms"),
    ],
)
def test_what_cannot_be_blurred_is_refused(values, complaint):
    with pytest.raises(ConfigError, match=complaint):
        blur(make_clip(), changed(PLAIN, **values))


def test_true_blur_of_several_cameras_is_refused():
    with pytest.raises(ConfigError, match="one recorded camera"):
        blur(make_clip(recorded=(0, 1)), changed(PLAIN, frames="true"))


def test_frames_that_are_not_evenly_spaced_are_refused():
    clip = make_clip()
    uneven = clip.timestamps.clone()
    uneven[5:] += 0.01
    with pytest.raises(ConfigError, match="evenly spaced frames, but intervals range from"):
        blur(dataclasses.replace(clip, timestamps=uneven), PLAIN)


def test_the_result_does_not_depend_on_how_many_threads_opencv_uses():
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        one, _ = blur(make_clip(), PLAIN)
        cv2.setNumThreads(2)
        two, _ = blur(make_clip(), PLAIN)
    finally:
        cv2.setNumThreads(before)
    assert torch.equal(one.frames, two.frames)
