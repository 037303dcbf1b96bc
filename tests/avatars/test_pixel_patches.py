import pytest
import torch

from deblur_avatar.avatars.pixel_patches import RaysParams, draw_patches, patch_middles, weighed
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from tests.randomness import seeded

RAYS = {"patches": 2, "size": 3, "on_person": 0.8, "coarse": 4}


def masks():
    likely, possible = torch.zeros(2, 9, 7, dtype=torch.bool)
    possible[1:8, 1:6] = True
    likely[3:5, 2:4] = True
    return likely, possible


def test_so_many_patches_have_their_middle_where_the_body_is():
    likely, possible = masks()
    middles = patch_middles(likely, possible, 0.8)
    assert float(middles.sum()) == pytest.approx(1.0)
    inside = 0.8 + 0.2 * 4 / 35
    assert float(middles[likely].sum()) == pytest.approx(inside)
    assert middles[likely].std() < 1e-7
    assert not middles[~possible].any()


def test_where_nothing_can_be_seen_every_pixel_is_as_good():
    nothing = torch.zeros(4, 5, dtype=torch.bool)
    torch.testing.assert_close(patch_middles(nothing, nothing, 0.8), torch.full((4, 5), 0.05))
    likely, possible = masks()
    assert patch_middles(~possible & False, possible, 0.8)[possible].std() < 1e-7


def test_a_patch_is_a_square_that_lies_in_the_picture():
    middles = torch.zeros(9, 7)
    middles[0, 6] = 1.0  # a corner of the picture
    drawn = draw_patches(middles, 1, 3, seeded())
    columns, rows = drawn.pixels.unbind(1)
    assert sorted(set(columns.tolist())) == [4, 5, 6]
    assert sorted(set(rows.tolist())) == [0, 1, 2]
    assert len(drawn.pixels) == 9
    middles = torch.zeros(9, 7)
    middles[4, 3] = 1.0
    columns, rows = draw_patches(middles, 1, 3, seeded()).pixels.unbind(1)
    assert (int(columns.min()), int(columns.max())) == (2, 4)
    assert (int(rows.min()), int(rows.max())) == (3, 5)


def test_patches_larger_than_the_picture_are_the_largest_that_fit():
    drawn = draw_patches(torch.full((4, 6), 1 / 24), 3, 100, seeded())
    assert set(drawn.pixels[:, 1].tolist()) == {0, 1, 2, 3}
    drawn = draw_patches(torch.full((4, 4), 1 / 16), 3, 100, seeded())
    assert len(drawn.pixels) == 16
    torch.testing.assert_close(drawn.weights, torch.ones(16))


@pytest.mark.parametrize(("patches", "size"), [(2, 3), (5, 1)])
def test_on_average_pixels_count_as_often_as_drawn_and_those_in_the_middle_once(patches, size):
    middles = patch_middles(*masks(), 0.7)
    generator, draws = seeded(), 2000
    counts, weights = torch.zeros(2, 9, 7)
    for _ in range(draws):
        drawn = draw_patches(middles, patches, size, generator)
        columns, rows = drawn.pixels.unbind(1)
        weights[rows, columns] += drawn.weights / draws
        if size == 1:
            assert len(torch.unique(drawn.pixels, dim=0)) == len(drawn.pixels)
        counts[rows, columns] += 1 / draws
    assert float((middles * weights).sum()) == pytest.approx(1.0, abs=0.03)
    reached = counts > 0
    if size == 1:  # where drawn, as often as patches' middles are there
        assert torch.equal(reached, middles > 0)
        usual = middles.square().sum()
        torch.testing.assert_close(weights, middles / usual, atol=0.05, rtol=0.2)
    # A pixel under two patches counts twice.
    twice = draw_patches(torch.full((4, 4), 1 / 16), 2, 4, seeded()).weights
    torch.testing.assert_close(twice, torch.ones(16))


def test_draws_come_from_the_generator():
    middles = patch_middles(*masks(), 0.7)
    torch.manual_seed(1)
    one = draw_patches(middles, 3, 2, seeded(5))
    torch.manual_seed(2)
    assert torch.equal(one.pixels, draw_patches(middles, 3, 2, seeded(5)).pixels)


def test_weights_are_of_gradients_and_leave_values_as_they_are():
    values = torch.rand(4, 3, generator=seeded(), requires_grad=True)
    weights = torch.tensor([0.0, 1.0, 7.0, 1e4])
    found = weighed(values, weights)
    assert torch.equal(found, values)
    found.sum().backward()
    assert torch.equal(values.grad, weights[:, None].expand(4, 3))


@pytest.mark.parametrize("change", [{"patches": 0}, {"size": 0}, {"on_person": 1.0}, {"coarse": 0}])
def test_draws_that_cannot_be_made_are_refused(change):
    parse(RaysParams, RAYS, "rays")
    with pytest.raises(ConfigError, match=next(iter(change))):
        parse(RaysParams, RAYS | change, "rays")
