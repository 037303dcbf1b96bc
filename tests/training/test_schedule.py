"""Tests of schedules: when stages end and levels follow each other."""

import pytest

from deblur_avatar.training.schedule import FULL, LevelParams, ScheduleParams

HALF = LevelParams(until=0.6, size=0.5, gaussians=0.25, virtual_poses=4)
FEW = LevelParams(until=0.8, size=1.0, gaussians=1.0, virtual_poses=4)


def schedule(*levels):
    return ScheduleParams(
        warmup=20, trajectory=60, fusion=100, gaussians=1000, image_height=64, levels=levels
    )


def test_iterations_belong_to_levels():
    growing = schedule(HALF, FEW)
    assert [growing.level_at(i) for i in (1, 60, 61, 80, 81, 100)] == [
        HALF, HALF, FEW, FEW, FULL, FULL
    ]  # fmt: skip
    assert [i for i in range(1, 101) if growing.grows_at(i)] == [61, 81]
    assert growing.gaussians_of(HALF) == 250
    assert growing.gaussians_of(FULL) == 1000


def test_without_levels_all_is_full_from_the_beginning():
    assert schedule().level_at(1) is FULL
    assert not any(schedule().grows_at(i) for i in range(1, 101))


@pytest.mark.parametrize("name", ["until", "size", "gaussians"])
def test_a_level_does_not_fall_behind_the_one_before(name):
    with pytest.raises(ValueError, match=f"levels: {name} must not fall from one level"):
        schedule(
            FEW, HALF.model_copy(update={"until": 0.9, "size": 1.0, "gaussians": 1.0} | {name: 0.1})
        )
