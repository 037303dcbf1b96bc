"""A second folder takes the body that the first one has baked."""

import logging

import pytest

from deblur_avatar.cli import shared_bodies as module
from deblur_avatar.cli.homes import DVC_CONFIG
from deblur_avatar.cli.shared_bodies import make_body

PIPELINE = """\
stages:
  body:
    foreach: ${bodies}
    do:
      cmd: python bake.py data/body/${key}
      params:
        - params.yaml: ["bodies.${key}"]
      outs: ["data/body/${key}"]
"""
# A file as good as any: a body's would have torch imported.
BAKE = """\
import sys; from pathlib import Path
with Path("baked").open("a") as file: file.write("once\\n")
Path(sys.argv[1]).mkdir(parents=True)
Path(sys.argv[1], "tensors").write_text("head and shoulders")
"""


@pytest.fixture
def home(tmp_path):
    """Makes a folder with a pipeline that bakes the capsules, and counts how often it does."""

    def make(name, tallness=1):
        folder = tmp_path / name
        (folder / ".dvc").mkdir(parents=True)
        (folder / ".dvc/config").write_text(DVC_CONFIG)
        (folder / "dvc.yaml").write_text(PIPELINE)
        (folder / "params.yaml").write_text(f"bodies: {{capsules: {{tallness: {tallness}}}}}\n")
        (folder / "bake.py").write_text(BAKE)
        return folder

    return make


def times_baked(folder):
    path = folder / "baked"
    return len(path.read_text().splitlines()) if path.exists() else 0


def body_of(folder):
    files = (folder / "data/body/capsules").iterdir()
    return {file.name: file.read_bytes() for file in files}


def test_a_second_folder_does_not_bake_again(home, cache):
    first, second, taller = home("first"), home("second"), home("taller", tallness=2)
    assert [make_body(folder, "capsules") for folder in (first, second, taller)] == [0, 0, 0]
    assert [times_baked(folder) for folder in (first, second, taller)] == [1, 0, 1]
    assert body_of(second) == body_of(first)


@pytest.fixture
def asked(monkeypatch):
    """What DVC would have been asked for; it does nothing."""
    words = []
    for name in ("reproduce", "push"):
        monkeypatch.setattr(module, name, lambda *a, name=name, **_: words.append(name) or 0)
    return words


def test_what_is_shared_already_is_not_asked_for(home, cache, asked):
    folder = home("first")
    (folder / "data/body/capsules").mkdir(parents=True)
    (folder / "dvc.lock").write_text(
        "stages: {body@capsules: {outs: [{path: data/body/capsules, md5: abcdef.dir}]}}\n"
    )
    assert make_body(folder, "capsules") == 0
    assert asked == ["reproduce", "push"]  # the cache was deleted, or never had it
    kept = cache / "bodies/files/md5/ab/cdef.dir"
    kept.parent.mkdir(parents=True)
    kept.touch()
    assert make_body(folder, "capsules") == 0
    assert asked == ["reproduce", "push"]
    (folder / "data/body/capsules").rmdir()
    assert make_body(folder, "capsules") == 0
    assert asked == ["reproduce", "push", "reproduce"]


def test_without_a_cache_a_folder_goes_on_alone(home, cache, asked, caplog):
    (cache / "bodies").touch()  # where a folder should be
    with caplog.at_level(logging.WARNING):
        assert make_body(home("first"), "capsules") == 0
    assert "The body is not shared with other folders" in caplog.text
    assert asked == []
