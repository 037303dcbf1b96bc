"""Frame numbers are told as runs."""

import pytest

from deblur_avatar.frame_numbers import TOLD, spans


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ([], ""),
        ([3], "3"),
        ([3, 4], "3 to 4"),
        ([3, 17, 18, 19, 52], "3, 17 to 19, 52"),
        (range(100), "0 to 99"),
    ],
)
def test_numbers_in_a_row_are_one_run(numbers, told):
    assert spans(numbers) == told


def test_of_many_runs_the_first_are_told_and_how_many_numbers_are_left():
    pairs = [10 * run + step for run in range(TOLD + 3) for step in (0, 1)]
    told = spans(pairs)
    assert told.endswith(f"{10 * TOLD - 10} to {10 * TOLD - 9} and 6 more")
    assert told.count(" to ") == TOLD
