"""What fitting leaves on disk on its way."""

import os
import shutil

import pytest
import torch

from deblur_avatar.cli.run_on_disk import STAGES, RunOnDisk, Standing
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
    begin("warmup", snapshots=(4,), saved=5, seconds=5.0)
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


def switch(fitting, before, after):
    """Change a run's parameters."""
    params = fitting / "params.yaml"
    text = params.read_text()
    assert before in text
    params.write_text(text.replace(before, after))


@pytest.mark.parametrize(
    ("ended", "stopped", "snapshots", "saved"),
    [
        (0, "warmup", (4,), 5), (1, "trajectory", (), 8), (1, "trajectory", (9,), 10),
        (2, "fusion", (), 15), (3, "warmup", (4,), 5),
    ],
)  # fmt: skip
def test_a_stopped_fit_counts_by_the_schedule_that_it_was_made_with(
    fitting, begin, end, ended, stopped, snapshots, saved
):
    for stage in STAGES[:ended]:
        end(stage)
    begin(stopped, snapshots=snapshots, saved=saved, seconds=6.0)
    before = RunOnDisk(fitting, "anna-lean")
    switch(fitting, "schedule: tiny", "schedule: longer")
    after = RunOnDisk(fitting, "anna-lean")
    assert after.standing() == before.standing() == Standing(saved, 18, 6.0)
    assert after.seconds_left() == before.seconds_left()
    if snapshots:
        fitted = after.fitted(after.newest(), after.observations())
        assert fitted.name == f"anna-lean, step {snapshots[-1]} of 18"


def test_where_nothing_tells_schedules_apart_the_present_one_counts(fitting, begin):
    begin("warmup", saved=2)  # before the first snapshot of either
    switch(fitting, "schedule: tiny", "schedule: longer")
    assert RunOnDisk(fitting, "anna-lean").standing().last == 80


def test_a_finished_fit_counts_by_the_schedule_that_it_was_made_with(fitting, end):
    for stage in STAGES:
        end(stage)
    switch(fitting, "fusion: 18", "fusion: 24")  # which no schedule has any more
    switch(fitting, "schedule: tiny", "schedule: longer")
    on_disk = RunOnDisk(fitting, "anna-lean")
    assert on_disk.standing() == Standing(18, 18, None)
    assert on_disk.fitted(on_disk.newest(), on_disk.observations()).name == "anna-lean"


def test_a_stopped_fit_of_a_schedule_that_is_gone_says_so(fitting, begin, end):
    end("warmup")
    begin("trajectory", snapshots=(9,), saved=10, seconds=8.0)
    switch(fitting, "fusion: 18", "fusion: 24")
    on_disk = RunOnDisk(fitting, "anna-lean")
    assert on_disk.standing() == Standing(10, None, 8.0)
    assert not on_disk.standing().finished
    assert on_disk.seconds_left() is None
    kept = on_disk.newest()
    assert on_disk.fitted(kept, on_disk.observations()).name == (
        "anna-lean, step 9, of another schedule"
    )


def test_a_snapshot_that_is_thrown_away_in_between_is_an_error_of_our_own(fitting, begin):
    begin("warmup", snapshots=(4,))
    on_disk = RunOnDisk(fitting, "anna-lean")
    kept = on_disk.newest()
    shutil.rmtree(kept.place)
    with pytest.raises(ArtifactError, match="no snapshot/1"):
        on_disk.fitted(kept, on_disk.observations())
