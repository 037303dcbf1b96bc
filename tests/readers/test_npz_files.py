import zipfile

import numpy as np
import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.readers import npz_files
from deblur_avatar.readers.npz_files import load_npz


def test_wanted_arrays_are_read_and_the_others_left(tmp_path):
    np.savez(tmp_path / "file.npz", a=np.arange(3), b=np.array([None], object))
    read = load_npz(tmp_path / "file.npz", {"a", "c"})
    assert list(read) == ["a"]
    np.testing.assert_array_equal(read["a"], [0, 1, 2])


def test_an_archive_that_unfolds_to_too_much_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(npz_files, "MAX_BYTES", 1 << 20)
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, poses=np.zeros(1 << 20))
    assert path.stat().st_size < 20_000
    with pytest.raises(ArtifactError, match=r"bomb.npz unfolds to 8 MB, at most 1 MB are read"):
        load_npz(path, {"poses"})
    assert load_npz(path, {"trans"}) == {}


def test_a_header_that_promises_too_much_is_damage(tmp_path):
    path = tmp_path / "file.npz"
    header = {"descr": "<f8", "fortran_order": False, "shape": (2**60,)}
    with zipfile.ZipFile(path, "w") as archive, archive.open("poses.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, header)
    with pytest.raises(ArtifactError, match=r"not a readable \.npz file"):
        load_npz(path, {"poses"})


def test_pickled_objects_and_damage_are_one_clear_error(tmp_path):
    path = tmp_path / "file.npz"
    np.savez(path, a=np.array([None], object))
    with pytest.raises(ArtifactError, match=r"not a readable \.npz file: .*allow_pickle"):
        load_npz(path, {"a"})
    np.savez(path, a=np.arange(1000))
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(ArtifactError, match=r"not a readable \.npz file"):
        load_npz(path, {"a"})
    with pytest.raises(ArtifactError, match="cannot read .*absent.npz: No such file"):
        load_npz(tmp_path / "absent.npz", {"a"})
