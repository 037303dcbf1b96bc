from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
import torch

from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.sources.multiview import MultiviewParams, load_multiview

WIDTH, HEIGHT, COUNT, FPS = 128, 48, 14, 30
NARROW = 126  # the second camera's pictures; its calibration says 128
CAMERA = """
[cam{index}]
name = "cam{index}"
size = [128.0, 48.0]
matrix = [[80.0, 0.0, 31.5], [0.0, 80.0, 23.5], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0]
rotation = [0.0, {turn}, 0.0]
translation = [0.0, 0.0, 3.0]
fisheye = false
"""


def picture(index: int, width: int) -> np.ndarray:
    """A bright square that moves 3 pixels a frame over a grey that counts frames."""
    image = np.full((HEIGHT, width, 3), 20 + 4 * index, np.uint8)
    image[16:32, 4 + 3 * index : 12 + 3 * index] = (250, 200, 150)
    return image


def bright(frames: torch.Tensor) -> torch.Tensor:
    """The square's matte."""
    return (frames[..., 0] > 180).to(torch.uint8) * 255


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("footage")
    for camera, width in enumerate((WIDTH, NARROW, WIDTH)):
        with av.open(str(folder / f"{camera}.mkv"), "w") as container:
            stream = container.add_stream("ffv1", rate=FPS)
            stream.width, stream.height, stream.pix_fmt = width, HEIGHT, "bgr0"
            for index in range(COUNT):
                frame = av.VideoFrame.from_ndarray(picture(index, width), format="rgb24")
                container.mux(stream.encode(frame.reformat(format="bgr0")))
            container.mux(stream.encode())
    tables = [CAMERA.format(index=index, turn=0.3 * index) for index in range(3)]
    (folder / "Calib.toml").write_text("\n".join(tables))
    return folder


def params(root: Path, **changes: Any) -> MultiviewParams:
    given: dict[str, Any] = {
        "source": "multiview",
        "root": str(root),
        "videos": ("0.mkv", "1.mkv", "2.mkv"),
        "calibration": "Calib.toml",
        "frame_offsets": (0, 0, 2),
        "principal_point_shifts": ((0.0, 0.0), (0.0, 0.0), (4.0, -2.0)),
        "frames": (1, 11),
        "image_height": 1000,
        "train_camera": 1,
        "pose_cameras": (0,),
        "test_stride": 3,
        "held_out": 0.2,
    }
    return MultiviewParams(**{**given, **changes})


def test_every_camera_is_read_at_the_same_instants(root: Path):
    clip, _ = load_multiview(params(root), bright)
    assert clip.frames.shape == (2, 10, HEIGHT, WIDTH, 3)
    assert clip.frames[:, 0, 2, 2, 0].tolist() == [24, 24]
    late = load_multiview(params(root, pose_cameras=(2,)), bright)[0]
    assert late.frames[:, 0, 2, 2, 0].tolist() == [24, 32]  # frames 1 and 1 + 2
    assert clip.recorded == (1, 0)
    assert clip.train_camera == 1
    assert clip.timestamps.tolist() == pytest.approx([(1 + i) / FPS for i in range(10)], abs=2e-3)
    assert clip.held_out_from == 8
    assert (clip.blurred, clip.mattes, clip.initial, clip.exact) == (False, None, None, None)


def test_narrow_pictures_keep_their_pixels_and_are_padded_on_the_right(root: Path):
    clip, _ = load_multiview(params(root), bright)
    assert torch.equal(clip.frames[0, 0, :, :NARROW], torch.from_numpy(picture(1, NARROW)))
    assert clip.frames[0, :, :, NARROW:].max() == 0
    assert clip.cameras.sizes.tolist() == [[WIDTH, HEIGHT]] * 3
    assert clip.cameras.Ks[1].tolist() == [[80, 0, 32], [0, 80, 24], [0, 0, 1]]


def test_a_principal_point_is_corrected(root: Path):
    clip, _ = load_multiview(params(root), bright)
    assert clip.cameras.Ks[2, :2, 2].tolist() == [36, 22]


def test_pictures_and_intrinsics_are_scaled_alike(root: Path):
    clip, reference = load_multiview(params(root, image_height=24), bright)
    assert clip.frames.shape[2:4] == (24, 64)
    assert reference.images.shape[1:3] == (24, 64)
    assert clip.cameras.Ks[2].tolist() == [[40, 0, 18], [0, 40, 11], [0, 0, 1]]
    assert clip.cameras.sizes.tolist() == [[64, 24]] * 3


def test_the_reference_shows_the_other_cameras_every_so_many_frames(root: Path):
    clip, reference = load_multiview(params(root, pose_cameras=()), bright)
    filmed = load_multiview(params(root), bright)[0].frames[1]
    assert reference.camera_indices.tolist() == [0, 0, 0, 2, 2, 2]
    assert reference.frame_indices.tolist() == [1, 4, 7, 1, 4, 7]
    assert reference.novel_pose.tolist() == [0] * 6
    held = load_multiview(params(root, pose_cameras=(), held_out=0.5), bright)[1]
    assert held.novel_pose.tolist() == [0, 0, 1, 0, 0, 1]
    person = bright(filmed[4:5])[0] > 0
    assert torch.equal(reference.mattes[1] > 0, person)
    # Background grey counts frames, so its median is not exact; the person is.
    assert torch.equal(reference.images[1][person], filmed[4][person])
    assert reference.images[1][~person].max() == 0
    assert reference.background == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("pose_cameras", [(), (0,), (2,)])
def test_no_pixel_of_a_scored_camera_is_recorded(root: Path, pose_cameras: tuple[int, ...]):
    clip, reference = load_multiview(params(root, pose_cameras=pose_cameras), bright)
    assert set(clip.recorded) == {1, *pose_cameras}
    assert len(clip.frames) == len(clip.recorded)
    assert set(reference.camera_indices.tolist()) == {0, 1, 2} - set(clip.recorded)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frame_offsets": (0, 0)}, "clip.frame_offsets must have one entry for each of 3 videos"),
        ({"principal_point_shifts": ()}, "clip.principal_point_shifts must have one entry"),
        ({"train_camera": 3}, "clip.train_camera: 3 of 3, counted from 0"),
        ({"frame_offsets": (0, -2, 0)}, "clip.frames: 1 to 11"),
        ({"frames": (3, 4)}, "under two"),
        ({"videos": ("0.mkv",), "frame_offsets": (0,), "principal_point_shifts": ((0.0, 0.0),),
          "train_camera": 0, "pose_cameras": ()}, "need a camera beside"),
        ({"pose_cameras": (0, 2)}, "need a camera beside"),
        ({"pose_cameras": (3,)}, "clip.pose_cameras: 3 of 3, counted from 0"),
        ({"pose_cameras": (1,)}, "or the training camera 1, which is recorded anyway"),
        ({"pose_cameras": (0, 0)}, "name a camera twice"),
    ],
)  # fmt: skip
def test_parameters_that_contradict_each_other_are_refused(root: Path, changes, message: str):
    with pytest.raises(ConfigError, match=message):
        load_multiview(params(root, **changes), bright)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"videos": ("0.mkv", "1.mkv", "9.mkv")}, r"no video .*9\.mkv"),
        ({"frames": (0, 14)}, r"2\.mkv ends after 14 frames, wanted frames 2 to 15"),
        ({"calibration": "no.toml"}, r"no calibration .*no\.toml"),
    ],
)
def test_files_that_are_missing_or_short_are_named(root: Path, changes, message: str):
    with pytest.raises(ArtifactError, match=message):
        load_multiview(params(root, **changes), bright)


def test_a_calibration_of_other_pictures_is_refused(root: Path):
    text = (root / "Calib.toml").read_text().replace("size = [128.0, 48.0]", "size = [256.0, 96.0]")
    (root / "Other.toml").write_text(text)
    with pytest.raises(ArtifactError, match=r"0\.mkv: frames are \(128, 48\), camera cam0 is"):
        load_multiview(params(root, calibration="Other.toml"), bright)


def test_a_missing_root_says_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("FOOTAGE_ROOT", str(tmp_path / "nowhere"))
    wanted = r"no folder .*nowhere; set FOOTAGE_ROOT to .*Demo_SinglePerson.*studio"
    with pytest.raises(ConfigError, match=wanted):
        load_multiview(params(Path("${FOOTAGE_ROOT:-x}")), bright)


def test_the_root_may_come_from_the_environment(monkeypatch: pytest.MonkeyPatch, root: Path):
    monkeypatch.setenv("FOOTAGE_ROOT", str(root))
    clip, _ = load_multiview(params(Path("${FOOTAGE_ROOT:-x}"), frames=(1, 4)), bright)
    assert clip.frames.shape[1] == 3
