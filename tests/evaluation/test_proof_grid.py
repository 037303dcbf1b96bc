import json

import pytest

from deblur_avatar.config.proof import Cell, cells_of
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.proof_grid import (
    Entry,
    grid_of,
    numbers_of,
    pooled_grid,
    read_cells,
    schedules_of,
)
from tests.proof_results import small_plan, write_cell

# Of the seen surface, by avatar and motion; the second seed has 1 dB more.
PSNR = {
    ("networks", "agnostic"): 15.0, ("networks", "paper"): 16.0, ("networks", "oracle"): 19.0,
    ("plain", "agnostic"): 16.0, ("plain", "clip"): 19.0, ("plain", "oracle"): 18.0,
}  # fmt: skip


@pytest.fixture
def found(tmp_path):
    for cell in cells_of(small_plan(), ["grid", "seeds"]).values():
        write_cell(
            tmp_path,
            cell,
            PSNR[cell.avatar, cell.motion] + cell.seed * (1 + (cell.motion == "clip")),
        )
    return read_cells(small_plan(), tmp_path)


def test_cells_that_are_not_there_are_left_out(tmp_path):
    write_cell(tmp_path, Cell("leaping", "plain", "clip", "x1", 0), 19.0)
    (only,) = read_cells(small_plan(), tmp_path)
    assert only.cell == Cell("leaping", "plain", "clip", "x1", 0)
    assert only.result["cost"]["train_s"] == 8.0
    assert [point["seconds"] for point in only.curve["points"]] == [2.0, 4.0, 8.0]


def test_recovery_is_taken_within_one_avatar_and_one_seed(found):
    grid = grid_of(found, "leaping", "x1")
    assert grid["networks"]["paper"].mean["recovery"]["psnr_seen"] == pytest.approx(1 / 4)
    # (19 - 16) / (18 - 16) in one seed, (21 - 17) / (19 - 17) in the other.
    clip = grid["plain"]["clip"]
    assert clip.mean["recovery"]["psnr_seen"] == pytest.approx((1.5 + 2.0) / 2)
    assert clip.seeds == (0, 1)
    assert clip.mean["image"]["psnr_seen"] == pytest.approx(20.0)
    assert clip.deviation["image"]["psnr_seen"] == pytest.approx(2**0.5)


def test_recovery_is_open_where_blur_costs_less_than_half_a_decibel(tmp_path):
    for motion, psnr in (("agnostic", 18.0), ("clip", 18.3), ("oracle", 18.49)):
        write_cell(tmp_path, Cell("leaping", "plain", motion, "x1", 0), psnr)
    grid = grid_of(read_cells(small_plan(), tmp_path), "leaping", "x1")
    assert grid["plain"]["clip"].mean["recovery"]["psnr_seen"] is None


def test_bounds_of_one_avatar_are_no_bounds_of_another(tmp_path):
    for avatar, motion in (("networks", "agnostic"), ("networks", "oracle"), ("plain", "clip")):
        write_cell(tmp_path, Cell("leaping", avatar, motion, "x1", 0), PSNR[avatar, motion])
    grid = grid_of(read_cells(small_plan(), tmp_path), "leaping", "x1")
    assert grid["plain"]["clip"].mean["recovery"]["psnr_seen"] is None


def test_schedules_do_not_mix(tmp_path):
    for cell in cells_of(small_plan(), ["converged"]).values():
        write_cell(tmp_path, cell, 18.0 + (cell.schedule == "x2"))
    found = read_cells(small_plan(), tmp_path)
    assert grid_of(found, "studio", "x1")["plain"]["clip"].mean["image"]["psnr_seen"] == 18.0
    assert grid_of(found, "studio", "x2")["plain"]["clip"].mean["image"]["psnr_seen"] == 19.0


def test_the_schedule_of_most_cells_comes_first(tmp_path):
    for cell in list(cells_of(small_plan(), ["converged"]).values())[1:]:
        write_cell(tmp_path, cell, 18.0)
    assert schedules_of(read_cells(small_plan(), tmp_path), "studio") == ["x2", "x1"]


def test_numbers_are_means_and_spreads_and_null_where_nobody_fitted(found):
    numbers = numbers_of(grid_of(found, "leaping", "x1")["plain"]["clip"])
    assert numbers["psnr_seen"] == {"mean": 20.0, "std": pytest.approx(2**0.5)}
    assert numbers["lpips_vgg"] == {"mean": None, "std": None}
    assert numbers["recovery"]["psnr_seen"] == pytest.approx(1.75)
    assert (numbers["train_s"], numbers["gaussians"], numbers["seeds"]) == (8.0, 300, [0, 1])
    assert numbers_of(None) is None


def test_results_of_another_method_are_refused(tmp_path):
    cell = Cell("leaping", "plain", "clip", "x1", 0)
    write_cell(tmp_path, cell, 19.0)
    path = tmp_path / "leaping/evaluate" / f"{cell.name}.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"method": "paper"}))
    with pytest.raises(ArtifactError, match=r"is not of lean on leaping; run `make proof`"):
        read_cells(small_plan(), tmp_path)


def test_schedules_of_as_many_cells_are_told_apart_by_their_length(tmp_path):
    for cell in cells_of(small_plan(), ["converged"]).values():
        write_cell(tmp_path, cell, 18.0)
    assert schedules_of(read_cells(small_plan(), tmp_path), "studio") == ["x2", "x1"]


def test_the_mean_over_scenes_is_of_cells_that_all_have_and_recovery_is_its_own(tmp_path):
    def written(scene, **psnr):
        for motion, value in psnr.items():
            write_cell(tmp_path, Cell(scene, "plain", motion, "x1", 0), value)

    written("leaping", agnostic=15.0, clip=16.0, oracle=19.0)
    written("leaping_17", agnostic=17.0, oracle=18.0, clip=18.0)
    found = read_cells(small_plan(), tmp_path)
    grids = [grid_of(found, scene, "x1") for scene in ("leaping", "leaping_17")]
    clip = pooled_grid(grids)["plain"]["clip"]
    assert clip.mean["image"]["psnr_seen"] == 17.0
    assert clip.deviation["image"]["psnr_seen"] == pytest.approx(2**0.5)
    # (17 - 16) / (18.5 - 16), where the scenes' own are 1/4 and 1.
    assert clip.mean["recovery"]["psnr_seen"] == pytest.approx(0.4)
    del grids[1]["plain"]["clip"]
    assert list(pooled_grid(grids)["plain"]) == ["agnostic", "oracle"]


def test_an_avatar_without_a_cell_on_every_scene_has_no_row_in_the_mean():
    entry = Entry((0,), {"image": {"psnr_seen": 16.0}}, {})
    grids = [
        {"plain": {"agnostic": entry}, "gart": {"clip": entry}},
        {"plain": {"agnostic": entry}},
    ]
    assert list(pooled_grid(grids)) == ["plain"]
