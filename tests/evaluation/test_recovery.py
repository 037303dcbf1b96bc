import pytest

from deblur_avatar.evaluation.metrics import metric
from deblur_avatar.evaluation.recovery import (
    averaged,
    compared,
    pooled,
    recovery,
    share_won_back,
    standard_deviations,
)

PSNR, FLIP = metric("psnr"), metric("flip")


def result(**image):
    return {"method": "any", "image": image, "recovery": {"psnr": None}}


@pytest.mark.parametrize(
    ("value", "expected"), [(24.0, 0.0), (28.0, 1.0), (25.0, 0.25), (23.0, -0.25), (30.0, 1.5)]
)
def test_recovery_is_nought_for_agnostic_and_one_for_the_oracle(value, expected):
    assert recovery(value, 24.0, 28.0, PSNR) == pytest.approx(expected)


def test_recovery_counts_down_where_smaller_is_better():
    assert recovery(0.10, 0.20, 0.05, FLIP) == pytest.approx(2 / 3)


@pytest.mark.parametrize(
    ("value", "agnostic", "oracle", "row"),
    [(25.0, 24.0, 24.45, PSNR), (25.0, 28.0, 24.0, PSNR), (0.1, 0.1, 0.2, FLIP),
     (None, 1.0, 2.0, PSNR), (1.0, None, 2.0, PSNR), (1.0, 0.0, None, PSNR),
     (25.0, 24.0, 28.0, metric("psnr_foreground"))],
)  # fmt: skip
def test_recovery_is_left_open_where_blur_costs_nothing_or_is_unknown(value, agnostic, oracle, row):
    assert recovery(value, agnostic, oracle, row) is None


def test_a_share_of_nothing_is_none():
    assert share_won_back(1.0, 2.0, 2.0) is None
    assert share_won_back(2.0, 3.0, 1.0) == 0.5


def test_all_methods_of_a_scene_are_compared():
    filled = compared(
        {
            "ceiling": result(psnr=30.0, flip=0.01, lpips_vgg=None),
            "oracle": result(psnr=28.0, flip=0.05, lpips_vgg=None),
            "agnostic": result(psnr=24.0, flip=0.15, lpips_vgg=None),
            "paper": result(psnr=25.0, flip=0.10, lpips_vgg=None),
        }
    )
    assert filled["paper"]["recovery"]["psnr"] == pytest.approx(0.25)
    assert filled["paper"]["recovery"]["flip"] == pytest.approx(0.5)
    assert filled["paper"]["recovery"]["lpips_vgg"] is None
    assert filled["paper"]["gap_to_ceiling_db"] == pytest.approx(5.0)
    assert filled["ceiling"]["gap_to_ceiling_db"] == 0
    assert filled["agnostic"]["recovery"]["psnr"] == 0
    assert filled["oracle"]["recovery"]["psnr"] == 1


def test_without_a_ceiling_or_an_oracle_the_rest_still_stands():
    filled = compared({"agnostic": result(psnr=24.0), "paper": result(psnr=25.0)})
    assert filled["paper"]["gap_to_ceiling_db"] is None
    assert filled["paper"]["recovery"]["psnr"] is None
    assert filled["paper"]["image"] == {"psnr": 25.0}


def test_whole_numbers_count_as_numbers():
    filled = compared(
        {"agnostic": result(psnr=24), "oracle": result(psnr=28), "a": result(psnr=25)}
    )
    assert filled["a"]["recovery"]["psnr"] == 0.25


def test_results_that_come_in_are_not_changed():
    given = {"agnostic": result(psnr=24.0), "oracle": result(psnr=25.0)}
    compared(given)
    assert given["oracle"]["recovery"] == {"psnr": None}


def test_scenes_are_averaged_over_what_was_measured():
    mean = averaged(
        [
            {"scene": "a", "method": "m", "image": {"psnr": 20.0, "lpips": None, "new": 1.0}},
            {"scene": "b", "method": "m", "image": {"psnr": 30.0, "lpips": None}, "gap": 2.0},
        ]
    )
    assert mean == {
        "method": "m", "image": {"psnr": 25.0, "lpips": None, "new": 1.0}, "gap": 2.0,
    }  # fmt: skip


def test_one_scene_is_its_own_average():
    only = {"method": "m", "image": {"psnr": 20.0, "lpips": None}, "model": {"parts": ["a", "b"]}}
    assert averaged([only]) == only


def test_recovery_over_scenes_is_that_of_the_averages():
    scenes = {
        "fast": {
            "agnostic": result(psnr=20.0),
            "oracle": result(psnr=24.0),
            "a": result(psnr=23.0),
        },
        "slow": {
            "agnostic": result(psnr=20.0),
            "oracle": result(psnr=20.2),
            "a": result(psnr=19.0),
        },
        "real": {"agnostic": result(psnr=10.0)},
    }
    mean = pooled(scenes, "a")
    assert mean["scenes"] == ["fast", "slow"]
    assert mean["image"]["psnr"] == 21.0
    assert mean["recovery"]["psnr"] == pytest.approx(2.0 / 4.2)  # not (0.75 - 5) / 2
    assert pooled(scenes, "agnostic")["scenes"] == ["fast", "slow", "real"]
    assert pooled(scenes, "agnostic")["recovery"]["psnr"] is None  # one scene has no oracle


def test_the_gap_over_scenes_is_averaged_where_there_is_a_ceiling():
    scenes = {
        "a": compared({"ceiling": result(psnr=30.0), "agnostic": result(psnr=20.0)}),
        "b": compared({"agnostic": result(psnr=25.0)}),
    }
    assert pooled(scenes, "agnostic")["gap_to_ceiling_db"] == 10.0


def test_numbers_scatter_over_scenes_where_two_measured_them():
    deviations = standard_deviations(
        [
            {"scene": "a", "image": {"psnr": 20.0, "lpips": None, "new": 1.0}},
            {"scene": "b", "image": {"psnr": 22.0, "lpips": None}},
            {"scene": "c", "image": {"psnr": 24.0, "lpips": None}},
        ]
    )
    assert deviations == {"image": {"psnr": 2.0}}
    assert standard_deviations([{"psnr": 1.0}]) == {}
