"""Hostile files that once ended a reader, or its machine; found by `tests/fuzz`."""

import io
import json
import pickle
import struct
import zipfile

import numpy as np
import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.readers import foreign_arrays
from deblur_avatar.readers.foreign_arrays import load_arrays, load_npy, load_npz
from deblur_avatar.sources.calibration import read_calibration
from deblur_avatar.sources.folders import file_inside
from deblur_avatar.sources.footage import files_in_order, read_footage
from deblur_avatar.sources.given_masks import read_masks
from deblur_avatar.sources.keypoint_files import read_keypoints
from deblur_avatar.sources.video_files import read_video, shrunk
from tests.sources.small_videos import picture, write_video


def test_a_calibration_in_an_unknown_encoding_is_refused(tmp_path):
    path = tmp_path / "a.qca.txt"
    path.write_bytes(b'<?xml version="1.0" encoding="foo"?><a/>')
    with pytest.raises(ArtifactError, match="is damaged: unknown encoding"):
        read_calibration(path, 1)


@pytest.mark.parametrize("text", ["a = " + "[" * 5000, ".".join("a" * 20_000) + " = 1"])
def test_deeply_nested_toml_is_refused(tmp_path, text):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(ArtifactError, match="a.toml is damaged"):
        read_calibration(tmp_path / "a.toml", 1)


def test_a_keypoint_file_of_a_far_frame_makes_no_list_up_to_it(tmp_path):
    entry = {"image_id": 10**13, "keypoints": [1.0] * 51}
    (tmp_path / "a.json").write_text(json.dumps([entry]))
    with pytest.raises(ArtifactError, match="holds no frame number up to"):
        read_keypoints(tmp_path / "a.json")


def test_an_array_that_claims_more_than_its_archive_holds_is_refused(tmp_path):
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000000,)}\n"
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("a.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
    (tmp_path / "a.npz").write_bytes(stream.getvalue())
    with pytest.raises(ArtifactError, match="needs over"):
        load_npz(tmp_path / "a.npz", {"a"})


def test_a_member_that_is_no_array_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a", b"raw bytes")
    with pytest.raises(ArtifactError, match="not a readable .npz"):
        load_npz(tmp_path / "a.npz", {"a"})


@pytest.mark.parametrize(
    ("program", "message"),
    [
        (b"\x80\x04})" + b"\x85" * 1_000_000 + b"K\x01s.", "ended the reader"),
        (b"\x80\x04\x8e" + struct.pack("<Q", 10**13), "not a readable"),
        (b"\x80\x04}\x8c\x01a]\x94(h\x00h\x00es.", "recursion"),
        (b"\x80\x04})K\x01s.", "keys are not all words"),
    ],
)
def test_pickles_that_would_break_their_reader_are_refused(tmp_path, program, message):
    (tmp_path / "a.pkl").write_bytes(program)
    with pytest.raises(ArtifactError, match=message):
        load_arrays(tmp_path / "a.pkl")


def test_a_list_that_unfolds_without_end_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(foreign_arrays, "MAX_SECONDS", 1)
    monkeypatch.setattr(foreign_arrays, "MAX_MEMORY", 1 << 29)
    value = [1.0] * 10
    for _ in range(30):
        value = [value] * 10
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"poses": value}))
    with pytest.raises(ArtifactError, match="over 1 s|over 512 MB"):
        load_arrays(tmp_path / "a.pkl")


def test_a_dtype_with_fields_of_its_own_making_is_refused(tmp_path):
    content = {"a": np.zeros(2, [("x", "f8")])}
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(content, 2))
    with pytest.raises(ArtifactError, match="records"):
        load_arrays(tmp_path / "a.pkl")


def test_a_npy_file_of_another_object_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.array(["text", None], object))
    with pytest.raises(ArtifactError, match="wanted a dictionary"):
        load_npy(tmp_path / "a.npy")


def test_a_video_that_names_another_file_is_refused(tmp_path):
    write_video(tmp_path / "other.mp4", [picture(0), picture(1)])
    (tmp_path / "a.mp4").write_text("ffconcat version 1.0\nfile other.mp4\n")
    with pytest.raises(ArtifactError, match="cannot be decoded"):
        read_video(tmp_path / "a.mp4", 0, None, 100)


def test_a_video_of_an_unknown_format_is_refused(tmp_path):
    path = write_video(tmp_path / "film.mp4", [picture(index, 16, 16) for index in range(3)])
    path.write_bytes(path.read_bytes().replace(b"avc1", b"zzz1"))
    with pytest.raises(ArtifactError, match=r"film\.mp4 is in a format that is not known; convert"):
        read_video(path, 0, None, 1080)


def test_a_very_tall_picture_keeps_a_column():
    assert shrunk(np.zeros((6000, 2, 3), np.uint8), 8).shape == (8, 1, 3)


def test_a_picture_may_have_a_number_in_its_name_that_python_cannot_read(tmp_path):
    (tmp_path / "frame\u00b2.png").write_bytes(b"")
    assert len(files_in_order(tmp_path, (".png",))) == 1


@pytest.mark.parametrize(
    "content", [b"\x89PNG\r\n\x1a\n" + b"\0" * 30, b"%!PS-Adobe-3.0 EPSF-3.0\n"]
)
def test_damaged_masks_and_programs_for_printers_are_refused(tmp_path, content):
    (tmp_path / "0.png").write_bytes(content)
    with pytest.raises(ArtifactError, match="not a picture"):
        read_masks(tmp_path, (0,), 1, (8, 6))
    with pytest.raises(ArtifactError, match="not a picture"):
        read_footage(tmp_path, (0, None), 1, 30.0, 8)


def test_a_name_with_a_zero_byte_is_refused(tmp_path):
    with pytest.raises(ArtifactError, match="can hold no file"):
        file_inside(tmp_path, "a\0b")
