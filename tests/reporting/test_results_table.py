import math

from deblur_avatar.reporting.results_table import (
    Column,
    look_up,
    markdown,
    method_order,
    plain,
    results_table,
    shown,
)

PSNR = Column(("image", "psnr"), "PSNR", "dB", 2, 1)
FLIP = Column(("image", "flip"), "FLIP", "", 3, -1)
COUNT = Column(("model", "gaussians"), "Gaussians", "", 0)
RESULTS = {
    "paper": {"image": {"psnr": 25.0, "flip": 0.1}, "model": {"gaussians": 9876}},
    "lean": {"image": {"psnr": 27.126, "flip": 0.05}, "model": {"gaussians": 12000}},
    "agnostic": {"image": {"psnr": 24.0, "flip": None}, "model": {"gaussians": 800}},
    "oracle": {"image": {"psnr": 29.0, "flip": 0.01}, "model": {"gaussians": 800}},
}


def ranks(table, column):
    return {method: cells[column].rank for method, cells in table.rows}


def test_rows_stand_in_the_order_of_the_argument():
    names = ["width-2", "paper", "lean", "ceiling", "agnostic", "a-variant", "oracle"]
    expected = ["ceiling", "oracle", "agnostic", "paper", "lean", "a-variant", "width-2"]
    assert method_order(names) == expected
    assert [method for method, _ in results_table(RESULTS, [PSNR]).rows] == expected[1:5]


def test_the_best_and_second_best_are_marked_among_methods_that_saw_the_blur():
    table = results_table(RESULTS, [PSNR, FLIP, COUNT])
    assert ranks(table, 0) == {"oracle": None, "agnostic": None, "paper": 2, "lean": 1}
    assert ranks(table, 1) == {"oracle": None, "agnostic": None, "paper": 2, "lean": 1}
    assert set(ranks(table, 2).values()) == {None}
    assert table.bounds == ("oracle",)


def test_equal_numbers_share_a_place_and_a_lone_number_has_none():
    def of(**values):
        return results_table({m: {"image": {"psnr": v}} for m, v in values.items()}, [PSNR])

    assert ranks(of(agnostic=1.0, paper=3.0, lean=3.0), 0) == {"agnostic": 2, "paper": 1, "lean": 1}
    assert ranks(of(agnostic=1.0, paper=2.001, lean=2.004), 0) == {
        "agnostic": 2,
        "paper": 1,
        "lean": 1,
    }
    assert ranks(of(agnostic=2.0, paper=2.0), 0) == {"agnostic": None, "paper": None}
    assert ranks(of(agnostic=None, paper=2.0), 0) == {"agnostic": None, "paper": None}


def test_numbers_are_shown_with_their_digits_and_signs():
    assert shown(27.126, PSNR) == "27.13"
    assert shown(None, PSNR) == "not measured"
    assert shown(None, PSNR, "—") == "—"
    assert shown(-0.5, PSNR) == "\u22120.50"
    assert shown(-0.001, PSNR) == "0.00"
    assert shown(1234567.0, COUNT) == "1\u2009234\u2009567"
    assert shown(0.5, Column(("a",), "share", "%", 0, factor=100.0)) == "50"


def test_what_is_not_a_finite_number_was_not_measured():
    result = {"a": {"b": 2, "c": math.inf, "d": "text", "e": True, "f": None}}
    assert look_up(result, ("a", "b")) == 2.0
    for path in (("a", "c"), ("a", "d"), ("a", "e"), ("a", "f"), ("a", "z"), ("z", "b"), ("a",)):
        assert look_up(result, path) is None


def test_the_readme_gets_bold_and_italics():
    lines = markdown(results_table(RESULTS, [PSNR, FLIP])).splitlines()
    assert lines[0] == "| method | PSNR (dB) ↑ | FLIP ↓ |"
    assert lines[1] == "| --- | ---: | ---: |"
    assert lines[2] == "| `oracle` | 29.00 | 0.010 |"
    assert lines[3] == "| `agnostic` | 24.00 | not measured |"
    assert lines[4] == "| `paper` | *25.00* | *0.100* |"
    assert lines[5] == "| `lean` | **27.13** | **0.050** |"


def test_the_terminal_gets_aligned_columns():
    lines = plain(results_table(RESULTS, [COUNT, PSNR])).splitlines()
    assert lines[0].split() == ["Gaussians", "PSNR", "dB"]
    assert len({line.rstrip(" *").rfind(".") for line in lines[1:]}) == 1  # decimal points in line
    assert "27.13 *" in lines[-1]
    assert "29.00 *" not in lines[1]
