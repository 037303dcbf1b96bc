from deblur_avatar.config.proof import Cell
from deblur_avatar.evaluation.proof_grid import Found
from deblur_avatar.reporting.stopping_table import stopping_table


def found(motion, *points, avatar="plain"):
    curve = [
        {"iteration": 100 * (i + 1), "image": {"psnr_seen": seen}, "validation_psnr": validation}
        for i, (seen, validation) in enumerate(points)
    ]
    return Found(Cell("pacing", avatar, motion, "x2", 0), {}, {"points": curve})


def texts(table, row):
    return [cell.text for cell in dict(table.rows)[row]]


AGNOSTIC = found("agnostic", (15.0, 30.0), (16.0, 31.0), (14.0, 32.0))
CLIP = found("clip", (16.0, 30.0), (17.5, 33.0), (17.0, 32.0))
ORACLE = found("oracle", (17.0, 33.0), (17.5, 31.0), (18.0, 30.0))


def test_each_rule_takes_its_own_point_of_every_cell():
    table = stopping_table([AGNOSTIC, CLIP, ORACLE], "pacing")
    assert texts(table, "plain, clip") == [
        "17.00", "300", "0.75",  # (17 - 14) / (18 - 14)
        "17.50", "200", "0.75",  # (17.5 - 16) / (18 - 16)
        "17.50", "200", "1.17",  # (17.5 - 14) / (17 - 14)
    ]  # fmt: skip
    assert texts(table, "plain, agnostic")[3:5] == ["16.00", "200"]
    assert texts(table, "plain, oracle")[6:8] == ["17.00", "100"]


def test_recovery_is_within_an_avatar_and_needs_its_bounds():
    alone = found("clip", (16.0, 30.0), (17.0, 31.0), avatar="gart")
    table = stopping_table([AGNOSTIC, CLIP, ORACLE, alone], "pacing")
    assert texts(table, "gart, clip")[2::3] == ["\u2013"] * 3


def test_no_recovery_where_blur_costs_too_little_at_the_best():
    bound = found("oracle", (16.3, 33.0), (16.2, 31.0), (16.1, 30.0))
    table = stopping_table([AGNOSTIC, CLIP, bound], "pacing")
    shares = texts(table, "plain, clip")[2::3]
    assert shares[1] == "\u2013" != shares[0]


def test_without_validation_frames_nothing_is_chosen_by_them():
    table = stopping_table([found("agnostic", (15.0, None))], "pacing")
    assert texts(table, "plain, agnostic")[6:] == ["\u2013"] * 3


def test_cells_without_a_scored_curve_are_left_out():
    unscored = Found(AGNOSTIC.cell, {}, {"points": [{"iteration": 1, "image": None}]})
    assert stopping_table([Found(CLIP.cell, {}, None), unscored], "pacing").rows == ()
