import pytest
import torch

from deblur_avatar.imaging.color import srgb_to_linear
from deblur_avatar.sources.studio.sensor import (
    DriftParams,
    NoiseParams,
    expose_rows,
    gains,
    instants_of_frame,
    record,
)
from tests.randomness import seeded


def test_instants_fill_the_exposure_about_its_middle():
    times = instants_of_frame(5, exposure=0.1, readout=0.0)
    assert times.tolist() == pytest.approx([-0.04, -0.02, 0.0, 0.02, 0.04])


def test_a_rolling_shutter_asks_for_the_time_it_reads_as_well():
    times = instants_of_frame(5, exposure=0.1, readout=0.06)
    assert len(times) == 8
    assert float(times[-1] - times[0]) == pytest.approx(0.14)
    assert float(times.sum()) == pytest.approx(0, abs=1e-12)


def test_without_readout_every_row_is_the_mean_of_all_instants():
    seen = torch.rand(5, 4, 3, generator=seeded())
    torch.testing.assert_close(expose_rows(seen, 5), seen.mean(0))


def test_later_rows_are_exposed_later():
    # Each instant is as bright as its number: a row's mean is the middle of its exposure.
    seen = torch.arange(8.0)[:, None, None].expand(8, 7, 2)
    rows = expose_rows(seen, 5)[:, 0]
    assert rows.tolist() == [2, 2, 3, 4, 4, 4, 5]


def test_a_vertical_bar_that_moves_leans_under_a_rolling_shutter():
    seen = torch.zeros(9, 5, 9)
    for instant in range(9):
        seen[instant, :, instant] = 1
    places = expose_rows(seen, 1).argmax(1)
    assert places.tolist() == [0, 2, 4, 6, 8]
    assert expose_rows(seen[4:5], 1).argmax(1).tolist() == [4] * 5


def test_noise_has_the_variance_of_shot_and_read_noise():
    noise = NoiseParams(shot=4e-4, read=0.004)
    for light in (0.1, 0.5):
        level = torch.full((200, 200, 3), light)
        taken = srgb_to_linear(record(level, torch.ones(3), noise, seeded()).float() / 255)
        wanted = (4e-4 * light + 0.004**2) ** 0.5
        assert float((taken - level).mean()) == pytest.approx(0, abs=5e-4)
        assert float((taken - level).std()) == pytest.approx(wanted, rel=0.05)


def test_without_noise_light_is_only_coded():
    assert record(torch.full((1, 1, 3), 0.5), torch.ones(3), None, seeded()).tolist() == [
        [[188, 188, 188]]
    ]
    assert record(torch.full((1, 1, 3), 7.0), torch.ones(3), None, seeded()).max() == 255


def test_exposure_drifts_by_the_stops_asked_for_and_comes_back():
    drift = DriftParams(stops=1.0, tint_stops=0.5, period_s=4.0)
    assert gains(0.0, drift).tolist() == pytest.approx([1, 1, 1])
    assert gains(1.0, drift).tolist() == pytest.approx([2**1.5, 2, 2**0.5])
    assert gains(3.0, drift).tolist() == pytest.approx([2**-1.5, 0.5, 2**-0.5])
    assert gains(1.0, None).tolist() == [1, 1, 1]


def test_the_same_seed_takes_the_same_picture():
    noise = NoiseParams(shot=4e-4, read=0.004)
    light = torch.rand(8, 8, 3, generator=seeded())
    first, again = (record(light, torch.ones(3), noise, seeded()) for _ in range(2))
    assert torch.equal(first, again)
