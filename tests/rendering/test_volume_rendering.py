import math

import pytest
import torch

from deblur_avatar.rendering.volume_rendering import (
    Rays,
    box_depths,
    composite,
    opacity,
    sample_depths,
    sample_weights,
)
from tests.randomness import seeded

LOW, HIGH = torch.tensor([-1.0, -2.0, 3.0]), torch.tensor([1.0, 2.0, 5.0])


def depths_of(origin, direction):
    direction = torch.nn.functional.normalize(torch.tensor([direction]), dim=1)
    near, far = box_depths(torch.tensor([origin]), direction, LOW, HIGH)
    return float(near), float(far)


def test_a_ray_enters_and_leaves_a_box_where_it_meets_its_faces():
    assert depths_of([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]) == pytest.approx((3.0, 5.0))
    near, far = depths_of([0.0, 0.0, 0.0], [0.25, 0.0, 1.0])
    slant = math.hypot(0.25, 1.0)
    assert (near, far) == pytest.approx((3 * slant, 4 * slant))  # leaves through the side


def test_a_ray_that_starts_inside_a_box_begins_there():
    assert depths_of([0.0, 0.0, 4.0], [0.0, 0.0, 1.0]) == pytest.approx((0.0, 1.0))


@pytest.mark.parametrize("origin", [[3.0, 0.0, 0.0], [0.0, 0.0, 9.0]])
def test_a_ray_that_misses_a_box_does_not_leave_after_entering(origin):
    near, far = depths_of(origin, [0.0, 0.0, 1.0])
    assert not far > near


def test_a_ray_along_a_face_meets_only_a_box_that_it_runs_through():
    near, far = depths_of([0.5, -9.0, 4.0], [0.0, 1.0, 0.0])
    assert (near, far) == pytest.approx((7.0, 11.0))
    near, far = depths_of([1.5, -9.0, 4.0], [0.0, 1.0, 0.0])
    assert not far > near


def test_each_equal_part_of_a_ray_has_one_sample():
    near, far = torch.tensor([1.0, 2.0]), torch.tensor([3.0, 6.0])
    middles = sample_depths(near, far, 4)
    torch.testing.assert_close(middles[0], torch.tensor([1.25, 1.75, 2.25, 2.75]))
    drawn = sample_depths(near, far, 4, seeded())
    assert ((drawn - middles).abs() <= (far - near)[:, None] / 8 + 1e-6).all()
    assert (drawn - middles).abs().max() > 0.1
    assert torch.equal(drawn, sample_depths(near, far, 4, seeded()))


def test_two_halves_of_matter_keep_back_what_the_whole_does():
    density = torch.tensor([0.0, 0.3, 40.0])
    whole, half = opacity(density, torch.tensor(0.2)), opacity(density, torch.tensor(0.1))
    torch.testing.assert_close(whole, 1 - (1 - half) ** 2)
    torch.testing.assert_close(whole[1], 1 - torch.tensor(-0.06).exp())


def test_compositing_is_a_loop_from_front_to_back():
    opacities = torch.rand(5, 7, generator=seeded())
    colors = torch.rand(5, 7, 3, generator=seeded(1))
    light, alpha = composite(opacities, colors)
    for ray in range(5):
        through, wanted = 1.0, torch.zeros(3)
        for sample in range(7):
            wanted += through * opacities[ray, sample] * colors[ray, sample]
            through = through * (1 - float(opacities[ray, sample]))
        torch.testing.assert_close(light[ray], wanted)
        assert float(alpha[ray]) == pytest.approx(1 - through, abs=1e-6)


def test_weights_are_positive_and_sum_to_at_most_one():
    weights = sample_weights(torch.rand(50, 64, generator=seeded()))
    assert weights.min() >= 0
    assert weights.sum(1).max() <= 1 + 1e-6


def test_nothing_is_seen_of_what_is_behind_something_opaque():
    weights = sample_weights(torch.tensor([[0.5, 1.0, 0.7]]))
    torch.testing.assert_close(weights, torch.tensor([[0.5, 0.5, 0.0]]))


def test_compositing_has_gradients_even_of_opaque_samples():
    opacities = torch.tensor([[0.0, 0.3, 1.0, 0.6]], dtype=torch.double, requires_grad=True)
    assert torch.autograd.gradcheck(lambda values: sample_weights(values), (opacities,))


def test_points_of_a_ray_are_as_far_along_it_as_their_depths():
    rays = Rays(torch.zeros(2, 3), torch.eye(3)[:2], torch.zeros(2), torch.ones(2))
    points = rays.at(torch.tensor([[1.0, 2.0], [3.0, 4.0]]))
    assert points[1].tolist() == [[0.0, 3.0, 0.0], [0.0, 4.0, 0.0]]
    assert len(rays) == 2
    assert rays.part(torch.tensor([False, True])).directions.tolist() == [[0.0, 1.0, 0.0]]
