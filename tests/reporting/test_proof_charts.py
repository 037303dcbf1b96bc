import re

from deblur_avatar.config.proof import MOTIONS
from deblur_avatar.reporting.charts import COLORS, drawn
from deblur_avatar.reporting.proof_charts import front_of, quality_chart

CURVES = {
    "networks": {"paper": [(10.0, 20.0), (40.0, 24.0)], "oracle": [(5.0, 25.0), (30.0, 29.0)]},
    "plain": {"clip": [(4.0, 19.0), (20.0, 25.0)]},
}


def texts(scenes):
    svg = drawn("chart", lambda: quality_chart(scenes, "PSNR, dB"))["chart.svg"].decode()
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def test_a_row_is_a_scene_and_a_column_an_avatar():
    said = texts({"leaping": CURVES, "lying": {"plain": CURVES["plain"]}})
    assert {"leaping, networks", "leaping, plain", "lying, plain"} <= set(said)
    assert {"paper", "oracle", "clip"} <= set(said)
    assert "lying, networks" not in said  # a panel without a curve


def test_seconds_over_many_decades_leave_each_other_room():
    near, far = ({"plain": {"clip": [(3.0, 19.0), (end, 25.0)]}} for end in (90.0, 900.0))
    assert {"5", "20", "50"} <= set(texts({"leaping": near}))
    said = set(texts({"leaping": far}))
    assert {"3", "10", "30", "100", "300"} <= said
    assert not {"5", "50", "200", "500"} & said


def test_the_front_is_over_both_avatars_and_leaves_out_who_saw_sharp_frames():
    assert front_of(CURVES) == [(4.0, 19.0), (10.0, 20.0), (20.0, 25.0)]


def test_equal_curves_give_equal_bytes():
    first, second = (
        drawn("chart", lambda: quality_chart({"leaping": CURVES}, "dB")) for _ in range(2)
    )
    assert first == second


def test_every_motion_of_the_grid_has_a_color_of_its_own():
    assert len({COLORS[motion] for motion in MOTIONS}) == len(MOTIONS)
