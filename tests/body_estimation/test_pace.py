import pytest
import torch

from deblur_avatar.body_estimation.pace import CLOSEST, pace_of, second_differences

TIMES = torch.tensor([0.0, 0.4, 1.0, 2.0, 2.5])


def test_evenly_spaced_frames_are_counted_whatever_the_rate():
    for fps in (12.0, 29.97, 240.0):
        pace = pace_of(torch.arange(400) / fps)
        assert pace.places.tolist() == list(range(400))
        assert pace.interval == pytest.approx(1 / fps, rel=1e-4)


def test_gaps_stay_and_frames_are_never_closer_than_a_camera_takes_them():
    pace = pace_of(torch.tensor([0.0, 0.1, 0.2, 0.5, 0.501, 0.6]))
    torch.testing.assert_close(
        pace.steps, torch.tensor([1.0, 1.0, 3.0, CLOSEST, 0.99]), check_dtype=False
    )


@pytest.mark.parametrize("count", [0, 1])
def test_a_frame_has_no_steps(count):
    pace = pace_of(torch.zeros(count))
    assert (pace.interval, len(pace.places), len(pace.steps)) == (1.0, count, 0)


def test_even_steps_give_second_differences_to_the_bit():
    values = torch.randn(9, 2, 3, generator=torch.Generator().manual_seed(0))
    found = second_differences(values, pace_of(torch.arange(9) / 29.97))
    assert torch.equal(found, values[2:] - 2 * values[1:-1] + values[:-2])


def test_a_parabola_accelerates_alike_at_any_spacing():
    pace = pace_of(TIMES)
    found = second_differences(3 * pace.places[:, None].float().square(), pace)
    standing_for = (pace.steps[:-1] + pace.steps[1:]) / 2
    torch.testing.assert_close(found[:, 0].double(), 6 * standing_for.sqrt(), rtol=1e-5, atol=0)
    assert second_differences(pace.places[:, None], pace).abs().max() < 1e-9  # nor does a line
