import pytest
import torch

from deblur_avatar.training import losses

pytestmark = pytest.mark.portable


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def image(seed=0, height=12, width=10):
    return torch.rand(height, width, 3, generator=seeded(seed), dtype=torch.float64)


BOX = (1, 2, 9, 11)
WHOLE = (0, 0, 10, 12)


def cloud(count=20):
    points = torch.randn(count, 3, generator=seeded(), dtype=torch.float64)
    near = torch.randint(0, count, (count, 4), generator=seeded(1))
    near = torch.where(near == torch.arange(count)[:, None], (near + 1) % count, near)
    return points, near


def test_nothing_is_lost_where_nothing_is_wrong():
    picture = image()
    weights = torch.rand(5, 24, generator=seeded()).softmax(1)
    assert losses.photometric(picture, picture) == 0
    assert losses.structure(picture, picture, BOX) == 0
    assert losses.coverage(picture[..., 0], picture[..., 0]) == 0
    assert losses.skinning(weights, weights) == 0


@pytest.mark.parametrize("name", ["dissimilarity", "structure"])
def test_stand_ins_for_lpips_see_a_blurred_picture_of_the_right_level(name):
    y, x = torch.meshgrid(torch.arange(32.0), torch.arange(32.0), indexing="ij")
    sharp = (torch.sin(x) * torch.cos(y) > 0).double()[..., None].expand(32, 32, 3)
    blurred = torch.full_like(sharp, float(sharp.mean()))
    box = (2, 2, 30, 30)
    loss = getattr(losses, name)
    assert loss(sharp, sharp, box) == pytest.approx(0)
    assert loss(blurred, sharp, box) > 3 * loss(sharp * 0.9, sharp, box) > 0
    moved = blurred.clone()
    moved[:2], moved[:, 30:] = 0, 1  # outside of the box
    assert loss(moved, sharp, box) == loss(blurred, sharp, box)


def test_dissimilarity_has_the_gradient_of_its_value():
    here, there = image(0, 12, 12).requires_grad_(), image(1, 12, 12)
    assert torch.autograd.gradcheck(lambda i: losses.dissimilarity(i, there, (0, 0, 12, 12)), here)
    tiny = losses.dissimilarity(here, there, (0, 0, 5, 5))
    assert tiny == 0


def test_photometric_and_coverage_are_mean_absolute_differences():
    here, there = torch.zeros(2, 2, 3), torch.zeros(2, 2, 3)
    there[0, 0] = torch.tensor([0.3, -0.6, 0.0])
    assert losses.photometric(here, there).item() == pytest.approx(0.9 / 12)
    assert losses.coverage(here[..., 0], there[..., 0]).item() == pytest.approx(0.3 / 4)


def test_structure_is_blind_to_levels_and_to_what_is_outside_its_box():
    picture = image()
    assert losses.structure(picture, picture + 0.3, BOX).item() == pytest.approx(0, abs=1e-12)
    elsewhere = picture.clone()
    elsewhere[:2], elsewhere[:, :1], elsewhere[11:], elsewhere[:, 9:] = 0, 0, 0, 0
    assert losses.structure(picture, elsewhere, BOX) == 0
    assert losses.structure(picture, elsewhere, WHOLE) > 0


def test_structure_of_a_step_is_its_height_over_all_differences_at_each_scale():
    step = torch.zeros(8, 8, 3)
    step[:, 4:] = 1.0
    # Of 7, 3 and 1 differences along a row one is 1; along the columns none is.
    expected = (1 / 7 + 1 / 3 + 1) / 6
    flat = torch.zeros_like(step)
    assert losses.structure(step, flat, (0, 0, 8, 8)).item() == pytest.approx(expected)


@pytest.mark.parametrize("box", [(0, 0, 4, 4), (3, 3, 4, 5)])
def test_tiny_boxes_have_finite_structure(box):
    assert torch.isfinite(losses.structure(image(), image(1), box))


def test_skinning_sums_over_joints_and_averages_over_points():
    weights = torch.tensor([[1.0, 0], [0.5, 0.5]])
    own = torch.tensor([[0.0, 1], [0.5, 0.5]])
    assert losses.skinning(weights, own).item() == pytest.approx(2 / 2)


def test_gradients_are_those_of_differences():
    picture, target = image(height=7, width=6).requires_grad_(), image(1, 7, 6)
    box = (0, 1, 6, 7)
    assert torch.autograd.gradcheck(lambda x: losses.photometric(x, target), picture)
    assert torch.autograd.gradcheck(lambda x: losses.structure(x, target, box), picture)
    assert torch.autograd.gradcheck(lambda x: losses.coverage(x[..., 0], target[..., 0]), picture)
    weights = torch.rand(3, 4, generator=seeded(), dtype=torch.float64, requires_grad=True)
    own = torch.rand(3, 4, generator=seeded(1), dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: losses.skinning(x, own), weights)


def test_what_is_the_same_everywhere_is_even_and_an_edge_costs_no_more_than_a_slope():
    row = torch.arange(10)
    near = torch.stack([(row - 1).clamp(min=0), (row + 1).clamp(max=9)], 1)
    flat, slope = torch.full((10, 1), 3.0), torch.linspace(0, 1, 10)[:, None]
    edge = (row > 4).float()[:, None]
    assert losses.unevenness(flat, near) == 0
    # Ten differences of a ninth, or one of 1, each met from both sides, among 20.
    assert losses.unevenness(slope, near).item() == pytest.approx(2 / 20)
    assert losses.unevenness(edge, near).item() == pytest.approx(2 / 20)


def test_unevenness_has_gradients_in_both_directions():
    points, near = cloud()
    values = points.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda v: losses.unevenness(v, near), values)
