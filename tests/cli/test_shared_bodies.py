"""A second folder takes the body that the first one has baked."""

import logging
import subprocess
import sys

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


def test_what_other_code_has_baked_to_the_same_bytes_is_not_baked_again_either(home, cache):
    """An update of the package changes how a body is baked and not what comes out."""
    assert make_body(home("first"), "capsules") == 0
    for name in ("updated", "second"):
        folder = home(name)
        (folder / "params.yaml").write_text("bodies: {capsules: {tallness: 1, version: 2}}\n")
        assert make_body(folder, "capsules") == 0
        assert times_baked(folder) == (name == "updated")
    assert body_of(folder) == {"tensors": b"head and shoulders"}


def test_a_second_folder_does_not_bake_again(home, cache):
    first, second, taller = home("first"), home("second"), home("taller", tallness=2)
    assert [make_body(folder, "capsules") for folder in (first, second, taller)] == [0, 0, 0]
    assert [times_baked(folder) for folder in (first, second, taller)] == [1, 0, 1]
    assert body_of(second) == body_of(first)


SETTINGS = """\
# this machine's
['remote "lab"']
    url = ../lab  # where everybody's data lie
[cache]
    dir = ../roomy
[core]
    autostage=false
"""


@pytest.mark.parametrize("default", ["", "    remote = lab\n"])
def test_the_user_s_settings_stay_and_nothing_of_theirs_is_sent_to_the_cache(home, cache, default):
    first, second = home("first"), home("second")
    settings = first / ".dvc/config.local"
    settings.write_text(SETTINGS + default)
    assert [make_body(folder, "capsules") for folder in (first, second)] == [0, 0]
    assert times_baked(second) == 0
    assert settings.read_text() == SETTINGS + default
    assert (first / "roomy/files/md5").is_dir()
    assert not (first / "lab").exists()
    held = sorted(cache.rglob("*"))
    (first / "diary").write_text("mine alone")
    for words in ("add diary", "push"):
        done = subprocess.run(
            [sys.executable, "-m", "dvc", *words.split()], cwd=first, capture_output=True,
            text=True, check=False,
        )  # fmt: skip
    assert (done.returncode == 0) == bool(default)
    assert (first / "lab").exists() or "no remote specified" in done.stderr
    assert sorted(cache.rglob("*")) == held


@pytest.fixture
def asked(monkeypatch):
    """What DVC would have been asked for; it does nothing."""
    words = []
    for name in ("reproduce_from", "push"):
        monkeypatch.setattr(module, name, lambda *a, name=name, **_: words.append(name) or 0)
    return words


def test_what_is_shared_already_is_not_asked_for(home, cache, asked):
    folder = home("first")
    (folder / "data/body/capsules").mkdir(parents=True)
    (folder / "dvc.lock").write_text(
        "stages: {body@capsules: {outs: [{path: data/body/capsules, md5: abcdef.dir}]}}\n"
    )
    assert make_body(folder, "capsules") == 0
    assert asked == ["reproduce_from", "push"]  # the cache was deleted, or never had it
    kept = cache / "bodies/files/md5/ab/cdef.dir"
    kept.parent.mkdir(parents=True)
    kept.touch()
    assert make_body(folder, "capsules") == 0
    assert asked == ["reproduce_from", "push"]
    (folder / "data/body/capsules").rmdir()
    assert make_body(folder, "capsules") == 0
    assert asked == ["reproduce_from", "push", "reproduce_from"]


def test_what_dvc_cannot_do_is_one_line_of_its_own(home, cache, caplog, capfd):
    folder = home("first")
    (cache / "bodies").mkdir()
    (cache / "bodies/files").touch()  # where a folder should be
    with caplog.at_level(logging.WARNING):
        assert make_body(folder, "capsules") == 0
    assert times_baked(folder) == 1
    assert caplog.messages == [
        f"The body is not shared with other folders: DVC cannot write {cache}/bodies"
    ]
    (folder / "bake.py").write_text("raise SystemExit(3)")
    (folder / "params.yaml").write_text("bodies: {capsules: {tallness: 2}}\n")
    capfd.readouterr()
    assert make_body(folder, "capsules") == 1
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("ERROR: failed to reproduce 'body@capsules': failed to run: python bake")


def test_without_a_cache_a_folder_goes_on_alone(home, cache, asked, caplog):
    (cache / "bodies").touch()  # where a folder should be
    with caplog.at_level(logging.WARNING):
        assert make_body(home("first"), "capsules") == 0
    assert "The body is not shared with other folders" in caplog.text
    assert asked == []
