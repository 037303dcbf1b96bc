import pytest

from deblur_avatar.config.proof import Cell
from deblur_avatar.evaluation.proof_grid import Entry, Found
from deblur_avatar.reporting.proof_tables import (
    UNKNOWN,
    convergence_table,
    grid_table,
    settled_s,
    windows_table,
)


def entry(psnr: float, share: float | None, **deviation: float) -> Entry:
    mean = {"image": {"psnr_seen": psnr}, "recovery": {"psnr_seen": share}}
    return Entry((0,), mean, {"image": {f"psnr_{k}": v for k, v in deviation.items()}})


def found(motion: str, psnr: float, iterations: int, half: float | None = None) -> Found:
    points = [] if half is None else [(iterations // 2, half), (iterations, psnr)]
    curve = [
        {"stage": "fusion", "iteration": i, "seconds": i / 10, "image": {"psnr_seen": q}}
        for i, q in points
    ]
    result = {"image": {"psnr_seen": psnr}, "run": {"iterations": iterations}}
    return Found(Cell("studio", "plain", motion, f"x{iterations}", 0), result, {"points": curve})


def texts(table, row):
    return [cell.text for cell in dict(table.rows)[row]]


def test_who_did_best_of_those_that_saw_blur_is_marked():
    grid = {"plain": {"agnostic": entry(16, 0.0), "clip": entry(19, 1.5), "oracle": entry(20, 1.0)}}
    marked = [cell.text for _, cells in grid_table(grid, "psnr_seen", "").rows for cell in cells
              if cell.rank]  # fmt: skip
    assert marked == ["19.00"]


def test_recovery_that_means_nothing_says_so():
    grid = {"plain": {"agnostic": entry(16, None), "clip": entry(16.2, None)}}
    table = grid_table(grid, "psnr_seen", "")
    assert UNKNOWN in texts(table, "plain: recovery")


def test_windows_show_what_at_least_two_of_them_have():
    short = {"plain": {"agnostic": entry(17, 0.0), "clip": entry(18, 0.9)}}
    long = {"plain": {"agnostic": entry(15, 0.0), "clip": entry(17, 0.7), "pair": entry(16, 0.2)}}
    table = windows_table({17: short, 49: long}, "psnr_seen", "")
    assert [row for row, _ in table.rows] == ["plain, agnostic", "plain, clip"]
    assert texts(table, "plain, clip") == ["18.00", "0.90", "17.00", "0.70"]


def test_a_doubling_is_of_the_longest_fit_over_half_its_length():
    cells = [found("clip", 18.0, 100), found("clip", 18.4, 200), found("clip", 18.45, 400, 18.0)]
    assert texts(convergence_table(cells, "studio"), "plain, clip") == [
        "18.00", "18.40", "18.45", "0.05", "0.45", "20", "40",
    ]  # fmt: skip


def test_without_a_fit_of_half_the_length_a_doubling_is_not_known():
    cells = [found("clip", 18.0, 100), found("clip", 18.4, 400), found("oracle", 19.0, 200)]
    table = convergence_table(cells, "studio")
    assert texts(table, "plain, clip")[3] == "\u2013"
    assert texts(table, "plain, oracle")[:4] == ["\u2013", "19.00", "\u2013", "\u2013"]


def test_a_curve_has_settled_at_95_per_cent_of_its_end():
    assert settled_s([(1.0, 10.0), (10.0, 19.0), (100.0, 20.0)]) == pytest.approx(10.0)
    assert settled_s([]) is None
