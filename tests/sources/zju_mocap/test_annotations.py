import os

import numpy as np
import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.zju_mocap.annotations import read_annotations
from tests.zju_sequence import CAMERAS, DISTORTION


class _Command:
    def __init__(self, command):
        self.command = command

    def __reduce__(self):
        return os.system, (self.command,)


@pytest.fixture
def content(sequence):
    return np.load(sequence.root / "annots.npy", allow_pickle=True).item()


@pytest.fixture
def read(tmp_path):
    """Write what annots.npy should hold, and read it."""

    def write_and_read(content):
        np.save(tmp_path / "annots.npy", content)
        return read_annotations(tmp_path / "annots.npy")

    return write_and_read


def named(content, rename):
    """The same frames with other names of the pictures."""
    frames = [
        {"ims": [rename(frame, camera) for camera in range(CAMERAS)]}
        for frame in range(len(content["ims"]))
    ]
    return {**content, "ims": frames}


def test_cameras_come_in_metres_with_our_pixel_centres(sequence):
    read = read_annotations(sequence.root / "annots.npy")
    np.testing.assert_allclose(read.viewmats.numpy(), sequence.viewmats, atol=1e-6)
    shift = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    np.testing.assert_allclose(read.Ks.numpy(), sequence.Ks + shift, atol=1e-5)
    np.testing.assert_allclose(read.distortion[3].numpy(), DISTORTION, atol=1e-7)
    assert read.camera_name(2) == "Camera_B3"


def test_frames_are_numbered_by_their_names_in_both_schemes(content, read):
    plain = named(content, lambda f, c: f"Camera_B{c + 1}/{f + 7:06d}.jpg")
    assert read(plain).frame_numbers(range(0, 6, 2), [0, 4]) == [7, 9, 11]
    dated = named(
        content,
        lambda f, c: f"Camera ({c + 1})/({c + 1})_1_2_3_{f + 1:04d}_x.592.jpg",
    )
    assert read(dated).frame_numbers(range(6), [0, 4]) == [1, 2, 3, 4, 5, 6]
    assert read(dated).camera_name(0) == "Camera (1)"
    nameless = named(content, lambda f, c: f"Camera_B{c + 1}/{'abcdef'[f]}.jpg")
    with pytest.raises(ArtifactError, match="'Camera_B1/a.jpg' holds no frame number"):
        read(nameless).frame_numbers(range(6), [0])


@pytest.mark.parametrize("third", [2, 4])
def test_dropped_and_repeated_frames_are_named(content, read, third):
    order = [0, 1, 2, third, third + 1, third + 2]
    found = read(named(content, lambda f, c: f"Camera_B{c + 1}/{order[f]:06d}.jpg"))
    with pytest.raises(ArtifactError, match=rf"frame 3 has number {third} after 2: .*missing or"):
        found.frame_numbers(range(6), [0])
    assert found.frame_numbers(range(3), [0]) == [0, 1, 2]
    assert found.frame_numbers(range(3, 6), [0]) == order[3:]


def test_frames_that_all_have_one_number_are_refused(content, read):
    found = read(named(content, lambda f, c: f"Camera_B{c + 1}/000004.jpg"))
    with pytest.raises(ArtifactError, match="frame 1 has number 4 after 4: .*missing or there twi"):
        found.frame_numbers(range(3), [0])


def test_a_camera_that_dropped_a_frame_is_named(content, read):
    late = named(content, lambda f, c: f"Camera_B{c + 1}/{f + (c == 4 and f > 2):06d}.jpg")
    with pytest.raises(ArtifactError, match=r"frame 3: camera Camera_B5 shows number 4, Camera_B1"):
        read(late).frame_numbers(range(6), [0, 4])
    assert read(late).frame_numbers(range(6), [0, 3]) == list(range(6))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("cams"), "wanted a dictionary with cams and ims, got ims"),
        (lambda c: c["cams"].pop("D"), "cams must hold K, R, T, D, got K, R, T"),
        (lambda c: c["cams"]["T"].pop(), "same cameras, got K of 9, R of 9, T of 8, D of 9"),
        (lambda c: c.update(ims=[]), "ims must list frames"),
        (lambda c: c["ims"][2]["ims"].pop(), r"ims\[2\] must list one picture .* 9 cameras, got 8"),
        (lambda c: c["ims"].__setitem__(1, None), r"ims\[1\] must list one picture .*, got 0"),
        (lambda c: c["cams"]["D"].__setitem__(1, np.ones(8)), r"D\[1\] must be \(5,\), got \(8,\)"),
        (lambda c: c["cams"]["K"].__setitem__(1, np.ones(9)), r"K\[1\] must be \(3, 3\), got"),
        (lambda c: c["cams"]["K"].__setitem__(1, "nine"), r"K\[1\] must be numbers, got 'nine'"),
        (lambda c: c["cams"]["R"].__setitem__(1, -np.eye(3)), "camera 1: .* mirrors the world"),
        (lambda c: c["cams"]["T"].__setitem__(1, np.full(3, np.nan)), r"T\[1\] .*not finite"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_annotations_is_named(content, read, change, message):
    change(content)
    with pytest.raises(ArtifactError, match=message) as refusal:
        read(content)
    assert "annots.npy" in str(refusal.value)


def test_an_array_or_no_file_is_refused(read, tmp_path):
    with pytest.raises(ArtifactError, match="wanted a dictionary with cams and ims, got an array"):
        read(np.zeros(3))
    with pytest.raises(ArtifactError, match="cannot read .*absent/annots.npy: No such file"):
        read_annotations(tmp_path / "absent/annots.npy")


def test_foreign_classes_are_refused_and_nothing_runs(content, read, tmp_path):
    trace = tmp_path / "trace"
    content["cams"]["K"][0] = _Command(f"touch {trace}")
    with pytest.raises(ArtifactError, match=r"wants to run (posix|nt)\.system.*nothing was exec"):
        read(content)
    assert not trace.exists()
