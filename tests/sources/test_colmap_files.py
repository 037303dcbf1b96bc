import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
import torch

from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.calibration import read_calibration

SIZE = (640, 480)
NAMES = ("cam10.png", "cam9.png")  # in the natural order the second is the first
# Values that these lenses have, by the names that pycolmap has for them.
VALUES = {
    "f": 500.0, "fx": 500.0, "fy": 510.0, "cx": 318.0, "cy": 243.0, "k": -0.05, "k1": -0.05,
    "k2": 0.02, "p1": 0.001, "p2": -0.002, "k3": 0.003,
}  # fmt: skip
LENSES = ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"]


def lens(model: str, number: int = 1) -> pycolmap.Camera:
    camera = pycolmap.Camera.create_from_model_name(number, model, 500.0, *SIZE)
    names = camera.params_info.split(", ")
    camera.params = [VALUES.get(name, 0.0) for name in names]
    return camera


def pose(index: int) -> pycolmap.Rigid3d:
    rotation = cv2.Rodrigues(np.array([0.1, 0.4 * index, -0.2]))[0]
    return pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), np.array([0.1 * index, 0.2, 3.0]))


def written(folder: Path, *cameras: pycolmap.Camera, text: bool = False) -> Path:
    """A reconstruction with one image a camera, and one point that both see."""
    folder.mkdir(parents=True)
    made = pycolmap.Reconstruction()
    for index, (name, camera) in enumerate(zip(NAMES, cameras, strict=True)):
        camera.camera_id = index + 7
        made.add_camera_with_trivial_rig(camera)
        image = pycolmap.Image(name=name, camera_id=index + 7, image_id=index + 1)
        image.points2D = [pycolmap.Point2D(np.array([1.0, 2.0]))] * (1 - index)
        made.add_image_with_trivial_frame(image, pose(index))
    (made.write_text if text else made.write_binary)(folder)
    return folder


@pytest.fixture
def sparse(tmp_path: Path) -> Path:
    return written(tmp_path / "sparse/0", lens("OPENCV"), lens("OPENCV"))


def pixels(cameras: Cameras, index: int, points: np.ndarray) -> np.ndarray:
    """Where our lens has points in space, by OpenCV."""
    viewmat, K = (v[index].double().numpy() for v in (cameras.viewmats, cameras.Ks))
    turn, shift = cv2.Rodrigues(viewmat[:3, :3])[0], viewmat[:3, 3]
    return cv2.projectPoints(points, turn, shift, K, cameras.distortion[index].double().numpy())[0]


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
@pytest.mark.parametrize("model", LENSES)
def test_points_are_seen_where_colmap_sees_them(tmp_path: Path, model: str, text: bool):
    folder = written(tmp_path / "sparse", lens(model), lens(model), text=text)
    read = read_calibration(folder, 2)
    assert read.names == ("cam9.png", "cam10.png")
    assert read.sizes.tolist() == [list(SIZE)] * 2
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (20, 3))
    for index in range(2):
        seen = pose(1 - index) * points
        wanted = lens(model).img_from_cam(seen)
        np.testing.assert_allclose(pixels(read, index, points)[:, 0], wanted, atol=2e-3)


def test_binary_and_text_files_say_the_same(tmp_path: Path):
    binary, text = (
        read_calibration(written(tmp_path / name, lens("RADIAL"), lens("RADIAL"), text=text), 2)
        for name, text in (("binary", False), ("text", True))
    )
    for field in ("Ks", "viewmats", "distortion"):
        assert torch.equal(getattr(binary, field), getattr(text, field))


def test_a_reconstruction_of_before_rigs_is_read(sparse: Path):
    for name in ("rigs.bin", "frames.bin", "points3D.bin"):
        (sparse / name).unlink()
    assert read_calibration(sparse, 2).names == ("cam9.png", "cam10.png")


@pytest.mark.parametrize("model", ["OPENCV_FISHEYE", "FOV", "SIMPLE_DIVISION"])
def test_lenses_that_are_not_straightened_here_are_refused(tmp_path: Path, model: str):
    folder = written(tmp_path / "sparse", lens("PINHOLE"), lens(model))
    message = rf"sparse: camera cam9.png: lens {model}, wanted SIMPLE_PINHOLE.*image_undistorter"
    with pytest.raises(ArtifactError, match=message):
        read_calibration(folder, 2)


def test_a_rational_lens_is_refused(tmp_path: Path):
    rational = lens("FULL_OPENCV")
    rational.params = [*rational.params[:-2], 0.1, 0.0]
    folder = written(tmp_path / "sparse", lens("PINHOLE"), rational)
    with pytest.raises(ArtifactError, match="camera cam9.png: lens FULL_OPENCV with k5; straight"):
        read_calibration(folder, 2)


def test_another_number_of_cameras_is_refused(sparse: Path):
    with pytest.raises(ArtifactError, match=r"has 2 cameras \(cam9.png, cam10.png\), the scene 3"):
        read_calibration(sparse, 3)


def test_a_folder_without_a_reconstruction_is_refused(sparse: Path):
    with pytest.raises(ArtifactError, match="sparse holds no reconstruction of COLMAP; wanted cam"):
        read_calibration(sparse.parent, 2)
    (sparse / "images.bin").unlink()
    with pytest.raises(ArtifactError, match="0 holds no reconstruction"):
        read_calibration(sparse, 2)
    shutil.rmtree(sparse)
    with pytest.raises(ArtifactError, match="no calibration .*sparse/0; check the scene's root"):
        read_calibration(sparse, 2)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_a_count_that_is_not_there_is_refused(sparse: Path, name: str):
    content = (sparse / name).read_bytes()
    (sparse / name).write_bytes(struct.pack("<Q", 2**63) + content[8:])
    with pytest.raises(ArtifactError, match="sparse/0 is damaged"):
        read_calibration(sparse, 2)


def test_a_pose_that_is_no_rotation_names_the_camera(sparse: Path):
    content = bytearray((sparse / "images.bin").read_bytes())
    content[12:20] = struct.pack("<d", 3.0)  # of the first image's quaternion
    (sparse / "images.bin").write_bytes(content)
    with pytest.raises(ArtifactError, match="sparse/0: camera cam.*: R is not a rotation matrix"):
        read_calibration(sparse, 2)
