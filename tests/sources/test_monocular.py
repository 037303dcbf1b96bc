import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.pipeline.clip import ClipParams
from deblur_avatar.sources.monocular import MonocularParams, load_monocular
from tests.sources.small_videos import FPS, HEIGHT, WIDTH, picture, write_video
from tests.sources.test_keypoint_files import openpose, points

COUNT = 6


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return write_video(tmp_path / "a.mp4", [picture(index) for index in range(COUNT)])


def params(path: Path, **changes: object) -> MonocularParams:
    asked: dict[str, object] = {
        "source": "monocular", "path": str(path), "frames": [0, None], "stride": 1, "fps": 30.0,
        "image_height": HEIGHT // 2, "focal": "field_of_view", "field_of_view": 60.0,
        "exposure_s": None, "shutter": 0.5, "averaging_space": "linear", "held_out": 0.0,
        "keypoints": None, "masks": None, "poses": None,
    }  # fmt: skip
    return parse(ClipParams, asked | changes, "scenes.mine.clip")


def load(body: Body, path: Path, **changes: object) -> tuple[Clip, Reference]:
    return load_monocular(params(path, **changes), body, nobody_asks)


def nobody_asks(frames: torch.Tensor) -> torch.Tensor:
    raise AssertionError("no mask is needed")


def test_a_video_becomes_a_blurred_clip_without_truth(body: Body, video: Path, tmp_path: Path):
    clip, reference = load(body, video)
    assert clip.blurred
    assert clip.frames.shape == (1, COUNT, HEIGHT // 2, WIDTH // 2, 3)
    assert clip.exposure == pytest.approx(0.5 / FPS)
    assert clip.averaging_space == "linear"
    assert len(reference.images) == 0
    for artifact in (clip, reference):
        artifact.save(tmp_path / "x")
        assert type(artifact).load(tmp_path / "x").schema == artifact.schema


def test_focal_lengths_are_scaled_with_the_frames(body: Body, video: Path):
    given, _ = load(body, video, focal=100.0)
    assert given.cameras.Ks[0, :2].tolist() == [[50, 0, WIDTH / 4], [0, 50, HEIGHT / 4]]
    viewed, _ = load(body, video)
    assert viewed.cameras.Ks[0, 0, 0] == pytest.approx(
        WIDTH / 4 / math.tan(math.radians(30)), rel=1e-5
    )


def test_an_exposure_in_seconds_wins_over_the_shutter(body: Body, video: Path):
    assert load(body, video, exposure_s=0.01)[0].exposure == 0.01


def test_only_an_exposure_that_is_to_be_estimated_is_a_guess(body: Body, video: Path):
    guessed, told = load(body, video, exposure_s="estimated")[0], load(body, video)[0]
    assert guessed.exposure == told.exposure
    assert guessed.exposure_std == pytest.approx(math.log(2))
    assert told.exposure_std is None
    assert load(body, video, exposure_s=0.01)[0].exposure_std is None


@pytest.mark.parametrize(("fps", "wanted"), [(25, 0.02), (5, 1 / 48)])
def test_frames_far_apart_had_no_longer_shutter(body: Body, tmp_path: Path, fps, wanted):
    """Half the time between frames that are taken one by one is no camera's shutter."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for index in range(COUNT):
        cv2.imwrite(str(folder / f"{index}.png"), picture(index))
    guessed = load(body, folder, exposure_s="estimated", fps=fps)[0]
    assert guessed.exposure == pytest.approx(wanted)
    assert load(body, folder, fps=fps)[0].exposure == pytest.approx(0.5 / fps)


def test_a_still_camera_s_focal_length_cannot_be_estimated_and_that_is_said(
    body: Body, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    noise = np.random.default_rng(0).integers(0, 255, (64, 96, 3)).astype(np.uint8)
    frames = [noise.copy() for _ in range(4)]
    for index, frame in enumerate(frames):
        frame[20:30, 4 * index : 4 * index + 10] = 0
    path = write_video(tmp_path / "b.mp4", frames)

    def segment(frames: torch.Tensor) -> torch.Tensor:
        return torch.zeros(frames.shape[:3], dtype=torch.uint8)

    with caplog.at_level("INFO"):
        load_monocular(params(path, focal="estimated", image_height=64), body, segment)
    assert "the camera stood still, so it cannot be estimated" in caplog.text


def test_what_a_user_brings_along_is_scaled_to_the_frames(body: Body, video: Path, tmp_path: Path):
    person = points(25, 20, HEIGHT - 12)
    (tmp_path / "k.json").write_text(json.dumps([openpose(person)] * COUNT))
    masks = tmp_path / "masks"
    masks.mkdir()
    for index in range(COUNT):
        Image.new("L", (WIDTH, HEIGHT), index + 1).save(masks / f"{index}.png")
    joints = len(body.parents) - 1
    zeros = {name: np.zeros((COUNT, 3)) for name in ("global_orient", "transl")}
    betas = np.zeros(body.shape_dirs.shape[2])
    np.savez(tmp_path / "p.npz", betas=betas, body_pose=np.zeros((COUNT, joints, 3)), **zeros)
    clip, _ = load(
        body, video, keypoints=str(tmp_path / "k.json"), masks=str(masks),
        poses=str(tmp_path / "p.npz"), stride=2,
    )  # fmt: skip
    assert clip.landmarks is not None
    assert clip.landmarks.shape == (1, 3, 33, 3)
    assert clip.landmarks[0, 0, 0].tolist() == pytest.approx([10, 5, 0.9])
    assert clip.mattes is not None
    assert clip.mattes.shape == (1, 3, HEIGHT // 2, WIDTH // 2)
    assert clip.mattes.min() == 255
    assert clip.initial is not None
    assert len(clip.initial.transl) == 3


def test_keypoints_of_another_length_are_refused(body: Body, video: Path, tmp_path: Path):
    path = tmp_path / "k.json"
    path.write_text(json.dumps([openpose(points(25, 20, 20))] * (COUNT + 1)))
    with pytest.raises(ArtifactError, match="is of 7 frames, the footage of 6"):
        load(body, video, keypoints=str(path))
    (tmp_path / "k").mkdir()
    for index in range(COUNT - 1):
        (tmp_path / "k" / f"{index}.json").write_text(json.dumps(openpose()))
    with pytest.raises(ArtifactError, match="is of 5 frames, the footage of 6"):
        load(body, video, keypoints=str(tmp_path / "k"))


def test_keypoints_of_the_whole_file_serve_a_part_of_it(body: Body, video: Path, tmp_path: Path):
    """Reading stops at the part's end, so that nobody knows how long the file is."""
    people = [openpose(points(25, 20 + index, 20)) for index in range(COUNT)]
    (tmp_path / "k.json").write_text(json.dumps(people))
    (tmp_path / "k").mkdir()
    for index, one in enumerate(people):
        (tmp_path / "k" / f"{index}.json").write_text(json.dumps(one))
    for name in ("k.json", "k"):
        clip, _ = load(body, video, keypoints=str(tmp_path / name), frames=(1, 4))
        assert clip.landmarks is not None
        assert clip.landmarks[0, :, 0, 0].tolist() == pytest.approx([10.5, 11, 11.5])
    (tmp_path / "k" / "3.json").unlink()
    (tmp_path / "k" / "4.json").unlink()
    (tmp_path / "k" / "5.json").unlink()
    with pytest.raises(ArtifactError, match="is of 3 frames, the footage of 4"):
        load(body, video, keypoints=str(tmp_path / "k"), frames=(1, 4))


def test_keypoints_of_nobody_or_of_another_size_are_refused(
    body: Body, video: Path, tmp_path: Path
):
    path = tmp_path / "k.json"
    path.write_text(json.dumps([openpose()] * COUNT))
    with pytest.raises(ArtifactError, match="shows no person"):
        load(body, video, keypoints=str(path))
    path.write_text(json.dumps([openpose(points(25, 900, 700))] * COUNT))
    with pytest.raises(ArtifactError, match="in pixels of the footage as recorded"):
        load(body, video, keypoints=str(path))


def test_a_missing_video_and_a_missing_variable_are_named(body: Body, tmp_path: Path):
    with pytest.raises(ConfigError, match=r"no video and no folder .*no\.mp4"):
        load(body, tmp_path / "no.mp4")
    with pytest.raises(ConfigError, match=r"clip\.path: set the environment variable MY_VIDEO"):
        load(body, Path("${MY_VIDEO}"))


def test_parameters_out_of_range_are_refused(tmp_path: Path):
    for changes in ({"focal": 0.0}, {"focal": "exif"}, {"shutter": 1.5}, {"held_out": 1.0}):
        with pytest.raises(ConfigError, match=next(iter(changes))):
            params(tmp_path, **changes)
