import subprocess
import sys
from pathlib import Path

import pytest

from deblur_avatar.cli import homes
from deblur_avatar.cli.avatar_params import prepare
from deblur_avatar.cli.homes import home_of
from deblur_avatar.errors import ArtifactError, ConfigError
from tests.sources.small_videos import picture, write_video

ROOT = Path(__file__).parents[2]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The home of one's own video, far from any checkout."""
    monkeypatch.chdir(tmp_path)
    video = write_video(tmp_path / "clip.mp4", [picture(index) for index in range(3)])
    return prepare(video, "clip", "lean", "medium", Path()).folder


def test_far_from_a_checkout_a_folder_has_all_that_a_pipeline_needs(folder):
    assert folder == Path("clip")
    listed = subprocess.run(
        [sys.executable, "-m", "dvc", "stage", "list", "--name-only"],
        cwd=folder, capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    assert {"code", "body@anny", "check@clip", "fusion@clip-lean", "export@clip-lean"} <= set(
        listed
    )
    code = subprocess.run(
        [sys.executable, "pipeline/stages/code.py", "--root", "pipeline", "--out", "code.json"],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert code.returncode == 0, code.stderr


def test_its_pipeline_follows_the_package_and_its_parameters_stay(folder):
    own = folder / "params.yaml"
    own.write_text(own.read_text().replace("field_of_view: 60.0", "field_of_view: 75.0"))
    stale = folder / "pipeline/stages/old.py"
    stale.touch()
    (folder / "dvc.yaml").write_text("stages: {}")
    prepare(Path("clip.mp4"), "clip", "lean", "medium", Path())
    assert not stale.exists()
    assert (folder / "dvc.yaml").read_bytes() == (ROOT / "dvc.yaml").read_bytes()
    assert (folder / "pipeline/params.yaml").read_bytes() == (ROOT / "params.yaml").read_bytes()
    assert "field_of_view: 75.0" in own.read_text()


def test_a_remote_that_its_user_has_added_stays(folder):
    config = folder / ".dvc/config"
    assert "no_scm = True" in config.read_text()
    command = [sys.executable, "-m", "dvc", "remote", "add", "--default", "lab", "/mnt/lab"]
    subprocess.run(command, cwd=folder, check=True)
    added = config.read_text()
    assert "url = /mnt/lab" in added
    prepare(Path("clip.mp4"), "clip", "lean", "medium", Path())
    assert config.read_text() == added


@pytest.mark.parametrize(
    ("written", "left"),
    [
        (  # by an earlier version alone
            "[core]\n    remote = bodies\n['remote \"bodies\"']\n    url = ../bodies\n",
            "[core]\n['remote \"bodies\"']\n    url = ../bodies\n",
        ),
        (
            "#\r\n[cache]\r\ndir =  /a # large\r\n[core]\r\nremote='bodies' # ?\r\nautostage=true",
            "#\r\n[cache]\r\ndir =  /a # large\r\n[core]\r\nautostage=true",
        ),
        *[
            (text, text)
            for text in (
                "[core]\nremote = lab\n['remote \"bodies\"']\nurl = /mnt/bodies\n",
                "[core]\n# remote = bodies\n",
                "core = remote\n",
                "",
            )
        ],
    ],
    ids=["untouched", "by hand", "of the user", "a comment", "no section", "empty"],
)
def test_a_default_remote_of_an_earlier_version_goes_and_all_else_stays(folder, written, left):
    settings = folder / ".dvc/config.local"
    settings.write_bytes(written.encode())
    prepare(Path("clip.mp4"), "clip", "lean", "medium", Path())
    assert settings.read_bytes() == left.encode()


@pytest.mark.parametrize("damaged", [b"[core\nremote = bodies\n", b"[core]\nremote = \xff\n", None])
def test_settings_that_dvc_cannot_read_are_named_and_stay(folder, damaged):
    settings = folder / ".dvc/config.local"
    if damaged is None:
        settings.mkdir()
    else:
        settings.write_bytes(damaged)
    with pytest.raises(ConfigError, match=r"clip/\.dvc/config\.local.*; mend it, or remove it"):
        prepare(Path("clip.mp4"), "clip", "lean", "medium", Path())
    assert settings.is_dir() if damaged is None else settings.read_bytes() == damaged


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path):
    (tmp_path / "clip").mkdir()
    with pytest.raises(ConfigError, match="holds no avatar, .* --name clip_avatar"):
        home_of("clip", tmp_path)


def test_a_disk_that_refuses_is_named(tmp_path):
    home = home_of("clip", tmp_path)
    (tmp_path / "clip").touch()
    with pytest.raises(ArtifactError, match=f"cannot write {tmp_path}/clip"):
        home.install()


def test_an_installed_wheel_brings_its_files_itself(tmp_path, monkeypatch):
    package = tmp_path / "deblur_avatar"
    (package / "pipeline_files").mkdir(parents=True)
    monkeypatch.setattr(homes.deblur_avatar, "__file__", str(package / "__init__.py"))
    assert homes.pipeline_files() == package / "pipeline_files"
