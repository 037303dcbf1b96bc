import hashlib
import os
import pickle
from pathlib import Path

import pytest
import torch

from deblur_avatar.errors import ArtifactError
from deblur_avatar.readers.weights_files import load_pth


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("zipped", [True, False], ids=["zip", "older"])
def test_tensors_come_back_by_name(tmp_path: Path, zipped: bool):
    path, state = tmp_path / "a.pth", {"a": torch.arange(6.0).view(2, 3), "b": torch.ones(1)}
    torch.save(state, path, _use_new_zipfile_serialization=zipped)
    found = load_pth(path, digest(path))
    assert found.keys() == state.keys()
    assert all(torch.equal(found[name], state[name]) for name in state)


class _Command:
    def __reduce__(self):
        return os.mkdir, ("canary",)


def test_nothing_of_another_file_is_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "a.pth"
    torch.save({"a": torch.ones(1)}, path)
    known = digest(path)
    path.write_bytes(pickle.dumps(_Command()))
    with pytest.raises(ArtifactError, match=rf"a.pth is not the published file: .*{known[:16]}"):
        load_pth(path, known)
    assert not (tmp_path / "canary").exists()


def test_what_is_no_file_is_named(tmp_path: Path):
    with pytest.raises(ArtifactError, match=r"cannot read .*absent.pth: No such file"):
        load_pth(tmp_path / "absent.pth", "0")
    with pytest.raises(ArtifactError, match="cannot read .*: Is a directory"):
        load_pth(tmp_path, "0")
