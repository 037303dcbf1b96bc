from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import camera_centres, look_at
from deblur_avatar.sources.calibration import read_calibration

UP = torch.tensor([0.0, 0.0, 1.0])  # both formats' worlds have +Z up
EYES = ((3.0, 1.0, 1.5), (-2.0, 2.5, 1.2))
DISTORTION = (-0.05, 0.14, 0.0006, -0.0007, 0.01)


def expected() -> Cameras:
    K = torch.tensor([[1680.0, 0, 533.5], [0, 1681.0, 948.5], [0, 0, 1]])
    target = torch.tensor([0.1, -0.2, 0.9])
    return Cameras(
        Ks=K.repeat(2, 1, 1),
        viewmats=torch.stack([look_at(torch.tensor(eye), target, UP) for eye in EYES]),
        distortion=torch.tensor(DISTORTION).repeat(2, 1),
        sizes=torch.tensor([[1088, 1920]] * 2),
        names=("north", "south"),
    )


def qualisys(cameras: Cameras) -> str:
    """What Qualisys would write: 1/64 pixels, millimetres, +Y up and -Z forward."""
    nodes = []
    for index, name in enumerate(cameras.names):
        R = np.diag([1, -1, -1]) @ cameras.viewmats[index, :3, :3].double().numpy()
        r = " ".join(f'r{i + 1}{j + 1}="{R[i, j]:.12f}"' for i in range(3) for j in range(3))
        x, y, z = 1000 * camera_centres(cameras.viewmats)[index].double().numpy()
        K = 64 * (cameras.Ks[index].double().numpy() - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        k1, k2, p1, p2, k3 = cameras.distortion[index].tolist()
        width, height = cameras.sizes[index].tolist()
        nodes.append(
            f'<camera active="1" serial="{name}">'
            f'<fov_video bottom="{height - 1}" left="0" right="{width - 1}" top="0"/>'
            f'<transform {r} x="{x:.9f}" y="{y:.9f}" z="{z:.9f}"/>'
            f'<intrinsic centerPointU="{K[0, 2]}" centerPointV="{K[1, 2]}" '
            f'focalLengthU="{K[0, 0]}" focalLengthV="{K[1, 1]}" radialDistortion1="{k1}" '
            f'radialDistortion2="{k2}" radialDistortion3="{k3}" tangentalDistortion1="{p1}" '
            f'tangentalDistortion2="{p2}"/></camera>'
        )
    return f"<calibration><cameras>{''.join(nodes)}</cameras></calibration>"


def pose2sim(cameras: Cameras) -> str:
    tables = []
    for index, name in enumerate(cameras.names):
        viewmat = cameras.viewmats[index].double().numpy()
        K = cameras.Ks[index].double().numpy() - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
        rotation = cv2.Rodrigues(viewmat[:3, :3])[0][:, 0]
        tables.append(
            f"[int_cam{index}]\nname = '{name}'\n"
            f"size = {[float(v) for v in cameras.sizes[index]]}\nmatrix = {K.tolist()}\n"
            f"distortions = {cameras.distortion[index].tolist()}\n"
            f"rotation = {rotation.tolist()}\ntranslation = {viewmat[:3, 3].tolist()}\n"
            "fisheye = false\n"
        )
    return "\n".join(tables) + "\n[metadata]\nadjusted = false\nerror = 0.0\n"


FORMATS = [("Calib.qca.txt", qualisys), ("Calib.toml", pose2sim)]


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(("name", "write"), FORMATS)
def test_a_file_gives_back_the_cameras_it_was_written_from(tmp_path: Path, name, write):
    read = read_calibration(written(tmp_path, name, write(expected())), 2)
    assert read.names == ("north", "south")
    assert torch.equal(read.sizes, expected().sizes)
    for field in ("Ks", "viewmats", "distortion"):
        torch.testing.assert_close(
            getattr(read, field), getattr(expected(), field), atol=2e-5, rtol=1e-5
        )


def test_four_distortion_numbers_mean_a_fifth_of_zero(tmp_path: Path):
    text = pose2sim(expected()).replace(f", {expected().distortion[0, 4].item()}]", "]")
    read = read_calibration(written(tmp_path, "Calib.toml", text), 2)
    assert read.distortion[:, 4].tolist() == [0, 0]
    assert read.distortion[0, :4].tolist() == pytest.approx(DISTORTION[:4])


@pytest.mark.parametrize(("name", "write"), FORMATS)
def test_another_number_of_cameras_is_refused(tmp_path: Path, name, write):
    path = written(tmp_path, name, write(expected()))
    with pytest.raises(ArtifactError, match=r"has 2 cameras \(north, south\), the scene 3"):
        read_calibration(path, 3)


@pytest.mark.parametrize(("name", "write"), FORMATS)
def test_a_number_that_is_not_finite_names_file_and_camera(tmp_path: Path, name, write):
    focal = {"Calib.qca.txt": 'focalLengthU="107520.0"', "Calib.toml": "[[1680.0,"}[name]
    before, after = write(expected()).rsplit(focal, 1)
    broken = before + focal.replace("107520.0", "nan").replace("1680.0", "nan") + after
    path = written(tmp_path, name, broken)
    with pytest.raises(ArtifactError, match=rf"{name}: camera (south|int_cam1).*finite"):
        read_calibration(path, 2)


def test_a_mirrored_world_names_file_and_camera(tmp_path: Path):
    text = qualisys(expected())
    start = text.rindex("r11=")
    row = text[start : text.index("r21=", start)]
    mirrored = row.replace('="-', '="~').replace('="', '="-').replace("-~", "")
    path = written(tmp_path, "Calib.qca.txt", text[:start] + text[start:].replace(row, mirrored))
    with pytest.raises(ArtifactError, match=r"Calib.qca.txt: camera south: det\(R\) = -1.000"):
        read_calibration(path, 2)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fisheye = false", "fisheye = true", "int_cam0: fisheye lenses"),
        ("rotation =", "turn =", "int_cam0: rotation is missing"),
        ("translation = [", "translation = [1.0, ", r"translation must have shape \(3,\)"),
        ("distortions = [", "distortions = ['a', ", "distortions must be numbers"),
        ("distortions = [", "distortions = [1.0, ", "4 or 5 numbers, got 6"),
        ("[int_cam0]", "[int_cam0", "is damaged"),
    ],
)
def test_damaged_tables_are_refused(tmp_path: Path, old: str, new: str, message: str):
    path = written(tmp_path, "Calib.toml", pose2sim(expected()).replace(old, new))
    with pytest.raises(ArtifactError, match=message):
        read_calibration(path, 2)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('r11="', 'r99="', "camera north: transform r11 must be a number, got None"),
        ("<fov_video", "<fov", "camera north: fov_video left must be a number"),
        ("</cameras>", "", "is damaged"),
    ],
)
def test_damaged_xml_is_refused(tmp_path: Path, old: str, new: str, message: str):
    path = written(tmp_path, "Calib.qca.txt", qualisys(expected()).replace(old, new))
    with pytest.raises(ArtifactError, match=message):
        read_calibration(path, 2)


def test_missing_files_and_unknown_kinds_are_refused(tmp_path: Path):
    with pytest.raises(ArtifactError, match=r"no calibration .*Calib\.toml"):
        read_calibration(tmp_path / "Calib.toml", 1)
    with pytest.raises(ArtifactError, match=r"unknown kind.*\.qca\.txt, \.toml"):
        read_calibration(written(tmp_path, "Calib.xml", ""), 1)
