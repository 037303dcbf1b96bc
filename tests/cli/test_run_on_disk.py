"""What fitting leaves on disk on its way."""

import os
import shutil

import pytest
import torch

from deblur_avatar.cli.run_on_disk import RunOnDisk, Standing
from deblur_avatar.errors import ArtifactError


def test_before_the_first_snapshot_there_is_nothing_to_show(fitting, begin):
    on_disk = RunOnDisk(fitting, "anna-lean")
    assert on_disk.newest() is None
    assert on_disk.standing() == Standing(0, 18, None)
    begin("warmup", saved=2, seconds=4.0)
    assert on_disk.newest() is None
    assert on_disk.standing() == Standing(2, 18, 4.0)
    assert on_disk.seconds_left() == 32.0  # 2 seconds for each of the 16 that are left


def test_the_newest_snapshot_is_shown_and_says_how_far_it_is(fitting, begin):
    begin("warmup", snapshots=(1, 4), saved=5, seconds=5.0)
    on_disk = RunOnDisk(fitting, "anna-lean")
    kept = on_disk.newest()
    assert kept.iteration == 4
    fitted = on_disk.fitted(kept, on_disk.observations())
    assert fitted.name == "anna-lean, step 4 of 18"
    assert fitted.avatar.iteration == 4
    assert on_disk.standing() == Standing(5, 18, 5.0)


def test_after_the_warm_up_the_avatar_moves_as_the_given_poses(fitting, begin, end, scene):
    end("warmup")
    begin("trajectory")
    on_disk = RunOnDisk(fitting, "anna-lean")
    kept = on_disk.newest()
    assert (kept.iteration, kept.whole) == (6, True)
    motion = on_disk.fitted(kept, on_disk.observations()).motion
    torch.testing.assert_close(motion.centre.transl, scene.observations.poses.transl)


def test_while_a_stage_runs_later_ones_are_of_an_earlier_fit(fitting, begin, end):
    for stage in ("warmup", "trajectory", "fusion"):
        end(stage)
    on_disk = RunOnDisk(fitting, "anna-lean")
    assert on_disk.standing() == Standing(18, 18, None)
    assert on_disk.fitted(on_disk.newest(), on_disk.observations()).name == "anna-lean"
    begin("trajectory", snapshots=(9,), saved=10, seconds=8.0)
    assert on_disk.newest().iteration == 9
    assert on_disk.seconds_left() == 16.0  # 4 steps took 8 s, 8 are left
    end("trajectory")
    assert on_disk.seconds_left() is None


@pytest.mark.parametrize("stopped", ["warmup", "trajectory", "fusion"])
def test_a_stopped_fit_is_passed_over_once_the_former_one_is_back(fitting, begin, end, stopped):
    for stage in ("warmup", "trajectory", "fusion"):
        end(stage)
    begin(stopped, snapshots=(3,), saved=4, seconds=8.0)  # of another schedule
    on_disk = RunOnDisk(fitting, "anna-lean")
    assert on_disk.newest().iteration == 3
    item = "capsules-blurred-lean" if stopped == "warmup" else "anna-lean"
    begun = fitting / f"data/{stopped}/.{item}.unfinished"
    checked_out = begun.stat().st_mtime_ns + 10**9
    os.utime(fitting / "data" / stopped / item, ns=(checked_out, checked_out))
    assert begun.is_dir()
    assert (on_disk.newest().iteration, on_disk.newest().whole) == (18, True)
    assert on_disk.standing() == Standing(18, 18, None)
    assert on_disk.seconds_left() is None


def test_a_snapshot_that_is_thrown_away_in_between_is_an_error_of_our_own(fitting, begin):
    begin("warmup", snapshots=(4,))
    on_disk = RunOnDisk(fitting, "anna-lean")
    kept = on_disk.newest()
    shutil.rmtree(kept.place)
    with pytest.raises(ArtifactError, match="no snapshot/1"):
        on_disk.fitted(kept, on_disk.observations())
