"""What a stage keeps while it runs, and who may use it."""

import json
import logging
import shutil

import pytest
import torch

from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.motion.frame import FixedMotion
from deblur_avatar.training import resume as module
from deblur_avatar.training.resume import (
    Progress,
    Snapshot,
    run_folder,
    run_key,
    taken_snapshots,
)

NONE: frozenset[int] = frozenset()


def work(tmp_path):
    return tmp_path / ".item.unfinished"


def stop(tmp_path, *iterations, key="key"):
    """A run that saved after these iterations and was stopped."""
    with run_folder(tmp_path / "item", key, NONE) as folder:
        for iteration in iterations:
            folder.save(iteration, 0.5 * iteration, 2, {"value": torch.full((3,), 1.0 * iteration)})


def test_a_run_that_was_stopped_goes_on_from_its_last_save(tmp_path):
    stop(tmp_path, 100, 200)
    with run_folder(tmp_path / "item", "key", NONE) as folder:
        progress = folder.progress
        assert progress is not None
        assert (progress.iteration, progress.seconds, progress.left_out) == (200, 100.0, 2)
        assert torch.equal(progress.tensors["value"], torch.full((3,), 200.0))
    assert [path.name for path in work(tmp_path).iterdir()] == ["after_000200"]


def test_what_other_code_parameters_or_inputs_left_is_thrown_away(tmp_path, caplog):
    stop(tmp_path, 100)
    with caplog.at_level(logging.INFO), run_folder(tmp_path / "item", "other", NONE) as folder:
        assert folder.progress is None
        assert not list(work(tmp_path).iterdir())
    assert "code, parameters or inputs changed" in caplog.text


def test_a_damaged_save_is_passed_over_for_the_one_before(tmp_path):
    stop(tmp_path, 100)
    shutil.copytree(work(tmp_path) / "after_000100", tmp_path / "before")
    stop(tmp_path, 200)
    shutil.move(tmp_path / "before", work(tmp_path) / "after_000100")
    torn = work(tmp_path) / "after_000200/tensors.safetensors"
    torn.write_bytes(torn.read_bytes()[:-4])
    with run_folder(tmp_path / "item", "key", NONE) as folder:
        assert folder.progress is not None
        assert folder.progress.iteration == 100


def test_a_save_that_the_disk_refuses_leaves_the_one_before(tmp_path, monkeypatch):
    def full(self, folder):
        raise OSError(28, "No space left on device")

    with run_folder(tmp_path / "item", "key", NONE) as folder:
        folder.save(100, 1.0, 0, {})
        monkeypatch.setattr(Progress, "_write", full)
        with pytest.raises(ArtifactError, match="No space left"):
            folder.save(200, 2.0, 0, {})
    assert [path.name for path in work(tmp_path).iterdir()] == ["after_000100"]


def test_a_second_process_is_refused_and_changes_nothing(tmp_path):
    with run_folder(tmp_path / "item", "key", NONE) as folder:
        folder.save(100, 1.0, 0, {})
        with (
            pytest.raises(ConfigError, match="another process is writing .*item; wait"),
            run_folder(tmp_path / "item", "other", NONE),
        ):
            pass
    assert [path.name for path in work(tmp_path).iterdir()] == ["after_000100"]
    with run_folder(tmp_path / "item", "key", NONE) as folder:
        assert folder.progress is not None


def test_a_folder_that_cannot_be_written_is_named_before_any_work():
    with (
        pytest.raises(ArtifactError, match="cannot write beside /proc/none/item"),
        run_folder(module.Path("/proc/none/item"), "key", NONE),
    ):
        pass


def test_saving_is_due_now_and_then(tmp_path, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    with run_folder(tmp_path / "item", "key", NONE) as folder:
        assert not folder.due()
        now[0] += module.SAVE_EVERY_S
        assert folder.due()
        folder.save(100, 1.0, 0, {})
        assert not folder.due()


def test_snapshots_are_handed_over_in_order_and_the_rest_is_gone(tmp_path, painted, observations):
    poses = observations.poses
    still = FixedMotion(poses).to_artifact(poses.betas, observations.timestamps)
    out = tmp_path / "item"
    with run_folder(out, "key", frozenset({4, 8, 99})) as folder:
        assert folder.wants(4)
        assert not folder.wants(5)
        for iteration in (8, 4):
            avatar = painted().to_artifact(iteration)
            folder.keep(iteration, 2.0 * iteration, Snapshot(avatar=avatar, motion=still))
        out.mkdir()
        taken = folder.finish(out)
    assert taken == [{"iteration": 4, "seconds": 8.0}, {"iteration": 8, "seconds": 16.0}]
    assert Snapshot.load(out / "snapshots/000008").avatar.iteration == 8
    assert sorted(path.name for path in tmp_path.iterdir()) == ["item"]
    assert json.dumps(taken)  # numbers that metrics can hold


def test_a_run_without_snapshots_leaves_no_folder_for_them(tmp_path):
    out = tmp_path / "item"
    with run_folder(out, "key", NONE) as folder:
        out.mkdir()
        assert folder.finish(out) == []
    assert not list(out.iterdir())


@pytest.mark.parametrize("change", ["fact", "setting", "content", "name"])
def test_a_key_tells_runs_apart(tmp_path, schedule, change):
    inputs = tmp_path / "inputs"
    inputs.mkdir()
    (inputs / "one").write_text("1")
    first = run_key([1], [schedule], [inputs])
    assert first == run_key([1], [schedule], [inputs])
    seed, setting = 1, schedule
    if change == "fact":
        seed = 2
    elif change == "setting":
        setting = schedule.model_copy(update={"gaussians": 81})
    elif change == "content":
        (inputs / "one").write_text("2")
    else:
        (inputs / "one").rename(inputs / "two")
    assert run_key([seed], [setting], [inputs]) != first


def test_a_key_tells_versions_of_the_code_apart(tmp_path, schedule, monkeypatch):
    (tmp_path / "code.py").write_text("x = 1")
    (tmp_path / "notes.txt").write_text("1")
    monkeypatch.setattr(module, "PACKAGE", tmp_path)
    first = run_key([1], [schedule], [])
    (tmp_path / "notes.txt").write_text("2")
    assert run_key([1], [schedule], []) == first
    (tmp_path / "code.py").write_text("x = 2")
    assert run_key([1], [schedule], []) != first


def kept(tmp_path):
    """A folder of two snapshots, as a run that was stopped leaves it."""
    for iteration in (4, 8):
        (tmp_path / f"snapshots/{iteration:06d}").mkdir(parents=True)
        path = tmp_path / f"snapshot_{iteration:06d}.json"
        path.write_text(json.dumps({"seconds": 2.0 * iteration}))
    return tmp_path


@pytest.mark.parametrize(
    "text", ["", "{", "2.0", "[]", "{}", '{"seconds": "2"}', '{"seconds": NaN}']
)
def test_a_snapshots_damaged_time_is_named_with_what_to_delete(tmp_path, text):
    (kept(tmp_path) / "snapshot_000008.json").write_text(text)
    with pytest.raises(
        ArtifactError, match=r"snapshot_000008\.json is damaged; delete .*, then run"
    ):
        taken_snapshots(tmp_path, {4, 8})


def test_a_time_whose_snapshot_is_gone_is_damage(tmp_path):
    assert len(taken_snapshots(kept(tmp_path), {4, 8, 12})) == 2
    shutil.rmtree(tmp_path / "snapshots/000004")
    with pytest.raises(ArtifactError, match=r"snapshot_000004\.json is damaged"):
        taken_snapshots(tmp_path, {4, 8, 12})


def test_a_run_stopped_while_it_handed_over_begins_anew(tmp_path, monkeypatch):
    def stopped(*_):
        raise KeyboardInterrupt

    out = tmp_path / "item"
    with run_folder(out, "key", frozenset({4})) as folder:
        folder.save(6, 1.0, 0, {})
        kept(work(tmp_path))
        monkeypatch.setattr(module.shutil, "move", stopped)
        with pytest.raises(KeyboardInterrupt):
            folder.finish(out)
    with run_folder(out, "key", frozenset({4})) as folder:
        assert folder.progress is None


def test_what_lies_in_the_folder_under_other_names_is_left_alone(tmp_path):
    stop(tmp_path, 100)
    (work(tmp_path) / "after_000200.bak").mkdir()
    (work(tmp_path) / "after_3x").touch()
    with run_folder(tmp_path / "item", "key", NONE) as folder:
        assert folder.progress is not None
        assert folder.progress.iteration == 100
