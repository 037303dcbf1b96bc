"""What fitting leaves on disk on its way, written here by the code that it is written with."""

import dataclasses
import shutil

import pytest
import torch
from ruamel.yaml import YAML

from deblur_avatar.cli.run_on_disk import RunOnDisk, Standing
from deblur_avatar.errors import ArtifactError
from deblur_avatar.training.resume import Snapshot, run_folder

ENDS = {"warmup": 6, "trajectory": 12, "fusion": 18}


@pytest.fixture
def folder(tmp_path, scene):
    """A run of which nothing was fitted yet."""
    run = {"scene": "capsules", "observations": "blurred", "avatar": "lean", "method": "lean"}
    sizes = {"gaussians": 80, "image_height": 24, "levels": []}
    content = {
        "from": {"footage": "data"}, "schedule": "tiny", "schedules": {"tiny": ENDS | sizes},
        "runs": {"anna-lean": run},
    }  # fmt: skip
    scene.observations.save(tmp_path / "data/preprocess/capsules/blurred")
    with (tmp_path / "params.yaml").open("w") as file:
        YAML().dump(content, file)
    return tmp_path


@pytest.fixture
def begin(folder, scene):
    """Begin a stage, let it come to some iterations, and stop it there."""

    def begin(stage, snapshots=(), saved=None, seconds=0.0):
        item = "capsules-blurred-lean" if stage == "warmup" else "anna-lean"
        with run_folder(folder / "data" / stage / item, "key", frozenset(snapshots)) as place:
            for iteration in snapshots:
                avatar = dataclasses.replace(scene.avatar, iteration=iteration)
                place.keep(iteration, 1.0, Snapshot(avatar=avatar, motion=scene.motion))
            if saved is not None:
                place.save(saved, seconds, 0, {"model.means": torch.zeros(3)})

    return begin


@pytest.fixture
def end(folder, scene):
    """End a stage, as its script does."""

    def end(stage):
        out = (
            folder
            / "data"
            / stage
            / ("anna-lean" if stage != "warmup" else "capsules-blurred-lean")
        )
        scene.avatar.save(out / "avatar")
        if stage != "warmup":
            scene.motion.save(out / "motion")
        shutil.rmtree(out.with_name(f".{out.name}.unfinished"), ignore_errors=True)

    return end


def test_before_the_first_snapshot_there_is_nothing_to_show(folder, begin):
    on_disk = RunOnDisk(folder, "anna-lean")
    assert on_disk.newest() is None
    assert on_disk.standing() == Standing(0, 18, None)
    begin("warmup", saved=2, seconds=4.0)
    assert on_disk.newest() is None
    assert on_disk.standing() == Standing(2, 18, 4.0)
    assert on_disk.seconds_left() == 32.0  # 2 seconds for each of the 16 that are left


def test_the_newest_snapshot_is_shown_and_says_how_far_it_is(folder, begin):
    begin("warmup", snapshots=(1, 4), saved=5, seconds=5.0)
    on_disk = RunOnDisk(folder, "anna-lean")
    kept = on_disk.newest()
    assert kept.iteration == 4
    fitted = on_disk.fitted(kept, on_disk.observations())
    assert fitted.name == "anna-lean, step 4 of 18"
    assert fitted.avatar.iteration == 4
    assert on_disk.standing() == Standing(5, 18, 5.0)


def test_after_the_warm_up_the_avatar_moves_as_the_given_poses(folder, begin, end, scene):
    end("warmup")
    begin("trajectory")
    on_disk = RunOnDisk(folder, "anna-lean")
    kept = on_disk.newest()
    assert (kept.iteration, kept.whole) == (6, True)
    motion = on_disk.fitted(kept, on_disk.observations()).motion
    torch.testing.assert_close(motion.centre.transl, scene.observations.poses.transl)


def test_while_a_stage_runs_later_ones_are_of_an_earlier_fit(folder, begin, end):
    for stage in ENDS:
        end(stage)
    on_disk = RunOnDisk(folder, "anna-lean")
    assert on_disk.standing() == Standing(18, 18, None)
    assert on_disk.fitted(on_disk.newest(), on_disk.observations()).name == "anna-lean"
    begin("trajectory", snapshots=(9,), saved=10, seconds=8.0)
    assert on_disk.newest().iteration == 9
    assert on_disk.seconds_left() == 16.0  # 4 steps took 8 s, 8 are left
    end("trajectory")
    assert on_disk.seconds_left() is None


def test_a_snapshot_that_is_thrown_away_in_between_is_an_error_of_our_own(folder, begin):
    begin("warmup", snapshots=(4,))
    on_disk = RunOnDisk(folder, "anna-lean")
    kept = on_disk.newest()
    shutil.rmtree(kept.place)
    with pytest.raises(ArtifactError, match="no snapshot/1"):
        on_disk.fitted(kept, on_disk.observations())
