"""Hashes of code are worked out once for a state of it, and again for any other."""

from pathlib import Path

import pytest

from deblur_avatar.config.remembered_code import MEMORY, Hashes, recalled, remember, state_of
from deblur_avatar.pipeline import code

HASHES = Hashes(scripts={"cut": "1"}, kinds={"avatars": {"plain": "2"}})


@pytest.fixture
def project(tmp_path: Path) -> Path:
    for name, text in {
        "deblur_avatar/__init__.py": "", "deblur_avatar/a.py": "A = 1\n",
        "deblur_avatar/a.cpp": "int a;\n", "stages/cut.py": "import deblur_avatar.a\n",
        ".dvc/tmp/lock": "",
    }.items():  # fmt: skip
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_what_was_remembered_is_recalled_of_the_same_state_alone(project):
    assert recalled(project, "then") is None
    remember(project, "then", HASHES)
    assert recalled(project, "then") == HASHES
    assert recalled(project, "now") is None


@pytest.mark.parametrize("content", ["", "{", "[]", '{"state": "then"}', "\0"])
def test_a_damaged_memory_is_none(project, content):
    (project / MEMORY).write_text(content)
    assert recalled(project, "then") is None


def test_a_folder_without_dvc_remembers_nothing(tmp_path):
    remember(tmp_path, "then", HASHES)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "change",
    [
        lambda root: (root / "deblur_avatar/a.py").write_text("A = 2\n"),
        lambda root: (root / "deblur_avatar/a.cpp").write_text("int b;\n"),
        lambda root: (root / "deblur_avatar/b.py").write_text(""),
        lambda root: (root / "deblur_avatar/a.py").rename(root / "deblur_avatar/c.py"),
        lambda root: (root / "deblur_avatar/a.cpp").unlink(),
        lambda root: (root / "stages/cut.py").write_text(""),
    ],
)
def test_any_file_of_the_code_is_part_of_its_state(project, change):
    folders = [project / "deblur_avatar", project / "stages"]
    before = state_of(folders)
    assert state_of(folders) == before
    (project / "deblur_avatar/__pycache__").mkdir()
    (project / "deblur_avatar/__pycache__/a.pyc").write_text("1")
    assert state_of(folders) == before
    change(project)
    assert state_of(folders) != before


def test_fingerprints_are_worked_out_once_for_a_state(project, monkeypatch):
    asked = []
    work_out = code._hashes
    monkeypatch.setattr(code, "_hashes", lambda root: asked.append(root) or work_out(root))
    first = code.fingerprints(project, project)
    assert code.fingerprints(project, project) == first
    assert asked == [project]
    (project / "deblur_avatar/a.py").write_text("A = 2\n")
    assert code.fingerprints(project, project) != first
    assert asked == [project] * 2
