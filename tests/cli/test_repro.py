import logging
import os
import re
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from deblur_avatar.cli import repro, running_dvc
from deblur_avatar.cli.main import main
from deblur_avatar.cli.warm_stages import warmed
from deblur_avatar.errors import ConfigError


@pytest.fixture
def folder(tiny_content, tmp_path, monkeypatch):
    """A folder with parameters for the studio and for footage that may or may not be there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("POSE2SIM_ROOT", raising=False)
    monkeypatch.setattr(running_dvc, "refresh", lambda root: [])
    (tmp_path / "dvc.yaml").touch()
    (tmp_path / "stages").mkdir()
    kept = ["studio", "courtyard_mono"]
    tiny_content["scenes"] = {name: tiny_content["scenes"][name] for name in kept}
    tiny_content["checks"], tiny_content["without_pictures"] = kept, []
    for section in ("warmups", "runs", "learning_curves", "self_checks", "exports"):
        entries = tiny_content[section].items()
        tiny_content[section] = {k: v for k, v in entries if v["scene"] in kept}
    tiny_content["scenes"]["courtyard_mono"]["clip"]["root"] = "${POSE2SIM_ROOT:-footage}"
    with (tmp_path / "params.yaml").open("w") as file:
        YAML().dump(tiny_content, file)
    return tmp_path


def test_footage_is_missing_where_its_folder_is(folder, monkeypatch):
    missing = repro.missing_footage(folder / "params.yaml")
    assert missing == {"courtyard_mono": "no folder footage (scenes.courtyard_mono.clip.root)"}
    (folder / "footage").mkdir()
    assert repro.missing_footage(folder / "params.yaml") == {}
    monkeypatch.setenv("POSE2SIM_ROOT", str(folder / "elsewhere"))
    assert (
        str(folder / "elsewhere") in repro.missing_footage(folder / "params.yaml")["courtyard_mono"]
    )


def test_a_video_is_missing_where_its_file_is(folder, tiny_content):
    clip = {
        "source": "monocular", "path": "mine.mp4", "frames": [0, None], "stride": 1, "fps": 30.0,
        "image_height": 48, "focal": "estimated", "field_of_view": 60.0, "exposure_s": None,
        "shutter": 0.5, "averaging_space": "linear", "held_out": 0.0, "keypoints": None,
        "masks": None, "poses": None,
    }  # fmt: skip
    tiny_content["scenes"]["courtyard_mono"]["clip"] = clip
    with (folder / "params.yaml").open("w") as file:
        YAML().dump(tiny_content, file)
    reason = "no video and no folder mine.mp4 (scenes.courtyard_mono.clip.path)"
    assert repro.missing_footage(folder / "params.yaml") == {"courtyard_mono": reason}
    (folder / "mine.mp4").touch()
    assert repro.missing_footage(folder / "params.yaml") == {}


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
    tiny_content["scenes"]["courtyard_mono"] |= {"body": "smpl", "clip": clip}
    with (folder / "params.yaml").open("w") as file:
        YAML().dump(tiny_content, file)
    for name in ("ZJU_MOCAP_ROOT", "SMPL_MODEL"):
        monkeypatch.delenv(name, raising=False)
    reason = repro.missing_footage(folder / "params.yaml")["courtyard_mono"]
    assert "scenes.courtyard_mono.clip.root: set the environment variable ZJU_MOCAP_ROOT" in reason
    assert "bodies.smpl.file: set the environment variable SMPL_MODEL" in reason
    monkeypatch.setenv("ZJU_MOCAP_ROOT", str(folder))
    monkeypatch.setenv("SMPL_MODEL", str(folder / "smpl.pkl"))
    (folder / "seq").mkdir()
    reason = f"no SMPL file {folder / 'smpl.pkl'} (bodies.smpl.file)"
    assert repro.missing_footage(folder / "params.yaml") == {"courtyard_mono": reason}
    (folder / "smpl.pkl").touch()
    assert repro.missing_footage(folder / "params.yaml") == {}


def test_parameters_that_cannot_be_run_stop_everything_at_once(folder):
    text = (folder / "params.yaml").read_text()
    (folder / "params.yaml").write_text(text.replace("virtual_poses:", "virtual_pose:"))
    with pytest.raises(ConfigError, match=r"unknown key 'trajectory.motion.virtual_pose'"):
        repro.missing_footage(folder / "params.yaml")


def test_what_can_be_made_is_every_run_of_the_other_scenes(folder, tiny_content):
    wanted = repro.targets(folder / "params.yaml", {"courtyard_mono": "gone"})
    runs = [name for name, run in tiny_content["runs"].items() if run["scene"] == "studio"]
    assert {f"evaluate@{name}" for name in runs} <= set(wanted)
    assert {"check@studio", "score_blur@studio", "score_predeblur@studio"} <= set(wanted)
    assert not any("courtyard_mono" in name for name in wanted)
    animated = [name for name in tiny_content["animations"] if name in runs]
    assert {f"animate@{name}" for name in animated} <= set(wanted)
    assert "export@studio-lean" in wanted
    assert repro.targets(folder / "params.yaml", {}) == []


def test_scenes_on_request_wait_until_they_are_asked_for(folder, tiny_content):
    tiny_content["on_request"] = ["courtyard_mono"]
    with (folder / "params.yaml").open("w") as file:
        YAML().dump(tiny_content, file)
    waiting = repro.not_asked_for(folder / "params.yaml", [])
    assert waiting == {"courtyard_mono": "it takes long; --scenes courtyard_mono makes it"}
    asked = repro.not_asked_for(folder / "params.yaml", ["courtyard_mono"])
    assert asked == {"studio": "it was not asked for"}
    with pytest.raises(ConfigError, match="no scene 'beach', there is studio, courtyard_mono"):
        repro.not_asked_for(folder / "params.yaml", ["beach"])


class Commands:
    """Stands in for DVC, and fails on request."""

    def __init__(self, monkeypatch, codes):
        self.calls, self.codes, self.paths = [], list(codes), []
        monkeypatch.setattr(running_dvc, "finish", self)

    def __call__(self, command, environment, folder):
        assert folder == Path()
        self.calls.append(command[1:])
        self.paths.append(environment["PATH"])
        return self.codes.pop(0)


def test_with_all_footage_everything_is_reproduced_and_the_table_shown(folder, monkeypatch, caplog):
    (folder / "footage").mkdir()
    (folder / "reports").mkdir()
    (folder / "reports" / "table.md").write_text("| method | PSNR |")
    commands = Commands(monkeypatch, [0])
    with caplog.at_level(logging.INFO):
        assert main(["repro"]) == 0
    assert commands.calls == [["-m", "dvc", "repro"]]
    assert "| method | PSNR |" in caplog.text
    assert "reports/index.html" in caplog.text
    warm = warmed({"PATH": ""})["PATH"]  # before all others, where stages run warm
    assert commands.paths[0].startswith(f"{warm}{Path(sys.executable).parent}{os.pathsep}")


def test_without_some_footage_its_scene_is_named_and_the_report_made_all_the_same(
    folder, monkeypatch, caplog
):
    (folder / "reports").mkdir()
    (folder / "reports" / "table.md").write_text("| table |")
    commands = Commands(monkeypatch, [0, 0])
    with caplog.at_level(logging.INFO):
        assert main(["repro"]) == 0
    assert "scene courtyard_mono is left out: no folder footage" in caplog.text
    assert "evaluate@studio-paper" in commands.calls[0]
    assert commands.calls[1] == ["-m", "dvc", "repro", "--single-item", "report"]


def test_scenes_asked_for_are_made_alone(folder, monkeypatch, caplog):
    (folder / "footage").mkdir()
    (folder / "reports").mkdir()
    (folder / "reports" / "table.md").write_text("| table |")
    commands = Commands(monkeypatch, [0, 0])
    with caplog.at_level(logging.INFO):
        assert main(["repro", "--scenes", "courtyard_mono"]) == 0
    assert "evaluate@courtyard_mono-paper" in commands.calls[0]
    assert not any("studio" in word for word in commands.calls[0])


@pytest.mark.parametrize(
    ("words", "on_request", "message"),
    [
        (["--scenes", "courtyard_mono"], [], "nothing of courtyard_mono can be made here: court"),
        ([], ["studio"], "nothing of params.yaml can be made here: each of its scenes is left out"),
        (["--scenes", "no_runs"], [], "nothing of no_runs can be made here: .* no run is of it"),
    ],
)
def test_where_no_scene_is_left_nothing_runs_and_not_everything(
    folder, tiny_content, monkeypatch, capsys, words, on_request, message
):
    tiny_content["on_request"] = on_request
    tiny_content["scenes"]["no_runs"] = tiny_content["scenes"]["studio"]
    with (folder / "params.yaml").open("w") as file:
        YAML().dump(tiny_content, file)
    commands = Commands(monkeypatch, [])
    assert main(["repro", *words]) == 1
    assert commands.calls == []
    [line] = capsys.readouterr().err.splitlines()
    assert re.search(message, line)


def test_a_failing_step_ends_it_with_its_exit_code(folder, monkeypatch):
    commands = Commands(monkeypatch, [3])
    assert main(["repro"]) == 3
    assert len(commands.calls) == 1


@pytest.mark.parametrize("command", [["repro"], ["report"], ["check"]])
def test_elsewhere_the_command_says_what_it_needs(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    assert main(command) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("ConfigError: no dvc.yaml, params.yaml, stages in ")
    assert line.endswith("start it in a checkout of deblur-avatar")


def test_scenes_are_checked_by_name(folder, monkeypatch, capsys):
    commands = Commands(monkeypatch, [0, 3])
    assert main(["check", "studio"]) == 0
    assert main(["check"]) == 3
    assert [call[-1] for call in commands.calls] == ["check@studio", "check"]
    assert main(["check", "studoi"]) == 1
    assert "no scene 'studoi' in params.yaml, there is studio" in capsys.readouterr().err


def test_the_report_alone_is_written_and_shown(folder, monkeypatch, caplog):
    (folder / "reports").mkdir()
    (folder / "reports" / "table.md").write_text("| table |")
    commands = Commands(monkeypatch, [0])
    with caplog.at_level(logging.INFO):
        assert main(["report"]) == 0
    assert commands.calls == [["-m", "dvc", "repro", "--single-item", "report"]]
    assert "| table |" in caplog.text
