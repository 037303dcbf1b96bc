from pathlib import Path

import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear
from deblur_avatar.pipeline.blur import BlurParams, blur
from deblur_avatar.pipeline.clip import ClipParams
from deblur_avatar.sources.high_speed import HighSpeedParams, load_high_speed
from tests.sources.small_videos import HEIGHT, WIDTH, write_video

COUNT, FPS = 22, 240.0


def moving(index: int) -> np.ndarray:
    """A white bar that goes two pixels a frame before a grey wall."""
    image = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
    image[8:24, 2 * index : 2 * index + 4] = 250
    return image


def of_bar(frames: torch.Tensor) -> torch.Tensor:
    return (frames[..., 0] > 200).to(torch.uint8) * 255


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return write_video(tmp_path / "a.mp4", [moving(index) for index in range(COUNT)])


def params(path: Path, **changes: object) -> HighSpeedParams:
    asked: dict[str, object] = {
        "source": "high_speed", "path": str(path), "frames": [0, None], "fps": FPS, "window": 5,
        "stride": 4, "image_height": HEIGHT, "focal": 100.0, "field_of_view": 60.0,
        "held_out": 0.0,
    }  # fmt: skip
    return parse(ClipParams, asked | changes, "scenes.mine.clip")


def load(path: Path, **changes: object) -> tuple[Clip, Reference]:
    return load_high_speed(params(path, **changes), of_bar)


def test_blur_is_the_mean_light_of_the_real_frames_around(video: Path):
    clip, _ = load(video)
    assert clip.frame_indices == (1, 2, 3, 4)
    sharp = torch.from_numpy(np.stack([moving(index) for index in range(COUNT)])).double() / 255
    for row, frame in enumerate(clip.frame_indices):
        around = sharp[4 * frame - 2 : 4 * frame + 3]
        wanted = linear_to_srgb(srgb_to_linear(around).mean(0)) * 255
        assert (clip.true_blur_linear[row] - wanted).abs().max() <= 0.51


def test_the_file_s_own_rate_does_not_count(video: Path):
    clip, _ = load(video)
    assert clip.timestamps.diff().tolist() == pytest.approx([4 / FPS] * 5)
    assert clip.true_blur_exposure == pytest.approx(5 / FPS)
    assert not clip.blurred


def test_the_blur_stage_takes_the_sums_and_keeps_the_sharp_middles(video: Path):
    clip, _ = load(video)
    asked = BlurParams(frames="true", factor=4, window=5, averaging_space="linear")
    blurred = blur(clip, asked)
    assert torch.equal(blurred.frames[0], clip.true_blur_linear)
    middles = torch.from_numpy(np.stack([moving(4 * frame) for frame in (1, 2, 3, 4)]))
    assert torch.equal(blurred.sharp_frames, middles)
    with pytest.raises(ConfigError, match=r"make clip\.window and blur\.window equal"):
        blur(clip, asked.model_copy(update={"window": 3}))


def test_every_sharp_instant_is_a_view_of_the_frame_nearest_to_it(video: Path):
    _, reference = load(video)
    instants = reference.frame_indices * 4 + (reference.offsets * FPS).round().long()
    assert instants.tolist() == list(range(2, 18))
    assert reference.offsets.abs().max() <= 2 / FPS + 1e-6
    assert reference.camera_indices.tolist() == [0] * 16
    for view, instant in enumerate(instants.tolist()):
        wanted = moving(instant)
        wanted[wanted == 60] = 0  # the person alone, on black
        assert (reference.images[view].int() - torch.from_numpy(wanted).int()).abs().max() <= 1


def test_of_the_held_out_part_only_middles_are_views(video: Path):
    clip, reference = load(video, held_out=0.5)
    assert clip.held_out_from == 3
    novel = reference.novel_pose == 1
    assert reference.frame_indices[novel].tolist() == [3, 4]
    assert reference.offsets[novel].tolist() == [0, 0]
    assert (reference.frame_indices[~novel] < 3).all()


def test_repeated_frames_are_refused(tmp_path: Path):
    pictures = [moving(index) for index in (0, 1, 1, 2, 3, 4, 5, 6, 7)]
    path = write_video(tmp_path / "b.mp4", pictures)
    with pytest.raises(ArtifactError, match="repeats frames"):
        load(path)


def test_windows_that_are_even_or_too_long_are_refused(video: Path):
    with pytest.raises(ConfigError, match=r"clip\.window: .*odd, got 4"):
        load(video, window=4)
    with pytest.raises(ConfigError, match=r"clip\.window: 41 frames are more than the video has"):
        load(video, window=41)


def test_a_missing_video_is_told(tmp_path: Path):
    reasons = params(tmp_path / "no.mov").missing_files("scenes.mine.clip")
    assert len(reasons) == 1
    assert "no.mov (scenes.mine.clip.path)" in reasons[0]
