import logging
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from deblur_avatar.cli import reproduce
from deblur_avatar.errors import ConfigError


@pytest.fixture
def folder(tiny_content, tmp_path, monkeypatch):
    """A folder with parameters for the studio and for footage that may or may not be there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("POSE2SIM_ROOT", raising=False)
    tiny_content["scenes"]["courtyard"]["clip"]["root"] = "${POSE2SIM_ROOT:-footage}"
    with (tmp_path / "params.yaml").open("w") as file:
        YAML().dump(tiny_content, file)
    return tmp_path


def test_footage_is_missing_where_its_folder_is(folder, monkeypatch):
    missing = reproduce.missing_footage(folder / "params.yaml")
    assert missing == {"courtyard": "no folder footage (scenes.courtyard.clip.root)"}
    (folder / "footage").mkdir()
    assert reproduce.missing_footage(folder / "params.yaml") == {}
    monkeypatch.setenv("POSE2SIM_ROOT", str(folder / "elsewhere"))
    assert (
        str(folder / "elsewhere") in reproduce.missing_footage(folder / "params.yaml")["courtyard"]
    )


def test_a_video_is_missing_where_its_file_is(folder, tiny_content):
    clip = {
        "source": "monocular", "path": "mine.mp4", "frames": [0, None], "stride": 1, "fps": 30.0,
        "image_height": 48, "focal": "estimated", "field_of_view": 60.0, "exposure_s": None,
        "shutter": 0.5, "light": "linear", "held_out": 0.0, "keypoints": None, "masks": None,
        "poses": None,
    }  # fmt: skip
    tiny_content["scenes"]["courtyard"]["clip"] = clip
    with (folder / "params.yaml").open("w") as file:
        YAML().dump(tiny_content, file)
    reason = "no video and no folder mine.mp4 (scenes.courtyard.clip.path)"
    assert reproduce.missing_footage(folder / "params.yaml") == {"courtyard": reason}
    (folder / "mine.mp4").touch()
    assert reproduce.missing_footage(folder / "params.yaml") == {}


def test_a_scene_of_a_data_set_lacks_its_folder_its_body_or_both(folder, tiny_content, monkeypatch):
    tiny_content["bodies"]["smpl"] = {
        "source": "smpl", "file": "${SMPL_MODEL}", "shape_components": 10,
    }  # fmt: skip
    clip = {
        "source": "zju_mocap", "root": "${ZJU_MOCAP_ROOT}/seq", "frames": [0, None], "stride": 1,
        "fps": 60.0, "image_height": 48, "train_camera": 0, "test_cameras": "all",
        "test_stride": 30, "pose_cameras": [], "mask_folders": ["mask"], "mask_dilation": 0,
        "background": "black", "poses": "new_params", "held_out": 0.0,
    }  # fmt: skip
    tiny_content["scenes"]["courtyard"] |= {"body": "smpl", "clip": clip}
    with (folder / "params.yaml").open("w") as file:
        YAML().dump(tiny_content, file)
    for name in ("ZJU_MOCAP_ROOT", "SMPL_MODEL"):
        monkeypatch.delenv(name, raising=False)
    reason = reproduce.missing_footage(folder / "params.yaml")["courtyard"]
    assert "scenes.courtyard.clip.root: set the environment variable ZJU_MOCAP_ROOT" in reason
    assert "bodies.smpl.file: set the environment variable SMPL_MODEL" in reason
    monkeypatch.setenv("ZJU_MOCAP_ROOT", str(folder))
    monkeypatch.setenv("SMPL_MODEL", str(folder / "smpl.pkl"))
    (folder / "seq").mkdir()
    reason = f"no SMPL file {folder / 'smpl.pkl'} (bodies.smpl.file)"
    assert reproduce.missing_footage(folder / "params.yaml") == {"courtyard": reason}
    (folder / "smpl.pkl").touch()
    assert reproduce.missing_footage(folder / "params.yaml") == {}


def test_parameters_that_cannot_be_run_stop_everything_at_once(folder):
    text = (folder / "params.yaml").read_text()
    (folder / "params.yaml").write_text(text.replace("virtual_poses:", "virtual_pose:"))
    with pytest.raises(ConfigError, match=r"unknown key 'trajectory.virtual_pose'"):
        reproduce.missing_footage(folder / "params.yaml")


def test_what_can_be_made_is_every_run_of_the_other_scenes(folder, tiny_content):
    wanted = reproduce.targets(folder / "params.yaml", {"courtyard": "gone"})
    runs = [name for name, run in tiny_content["runs"].items() if run["scene"] == "studio"]
    assert {f"evaluate@{name}" for name in runs} <= set(wanted)
    assert not any("courtyard" in name for name in wanted)
    animated = [name for name in tiny_content["animations"] if name in runs]
    assert {f"animate@{name}" for name in animated} <= set(wanted)
    assert reproduce.targets(folder / "params.yaml", {}) == []


class Commands:
    """Stands in for `subprocess.run`, and fails on request."""

    def __init__(self, monkeypatch, codes):
        self.calls, self.codes, self.paths = [], list(codes), []
        monkeypatch.setattr(subprocess, "run", self)

    def __call__(self, command, *, env, check):
        assert check is False
        self.calls.append(command[1:])
        self.paths.append(env["PATH"])
        return subprocess.CompletedProcess(command, self.codes.pop(0))


def test_with_all_footage_everything_is_reproduced_and_the_table_shown(folder, monkeypatch, caplog):
    (folder / "footage").mkdir()
    (folder / "reports").mkdir()
    (folder / "reports" / "table.md").write_text("| method | PSNR |")
    commands = Commands(monkeypatch, [0])
    with caplog.at_level(logging.INFO):
        assert reproduce.main() == 0
    assert commands.calls == [["-m", "dvc", "repro"]]
    assert "| method | PSNR |" in caplog.text
    assert "reports/index.html" in caplog.text
    assert commands.paths[0].startswith(str(Path(sys.executable).parent))


def test_without_some_footage_its_scene_is_named_and_the_report_made_all_the_same(
    folder, monkeypatch, caplog
):
    (folder / "reports").mkdir()
    (folder / "reports" / "table.md").write_text("| table |")
    commands = Commands(monkeypatch, [0, 0])
    with caplog.at_level(logging.INFO):
        assert reproduce.main() == 0
    assert "scene courtyard is left out: no folder footage" in caplog.text
    assert "evaluate@studio-paper" in commands.calls[0]
    assert commands.calls[1] == ["-m", "dvc", "repro", "--single-item", "report"]


def test_a_failing_step_ends_it_with_its_exit_code(folder, monkeypatch):
    commands = Commands(monkeypatch, [3])
    assert reproduce.main() == 3
    assert len(commands.calls) == 1
