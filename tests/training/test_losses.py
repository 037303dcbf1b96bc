import pytest
import torch

from deblur_avatar.training import losses
from tests.randomness import seeded

pytestmark = pytest.mark.portable


def image(seed=0, height=12, width=10):
    return torch.rand(height, width, 3, generator=seeded(seed), dtype=torch.float64)


def test_nothing_is_lost_where_nothing_is_wrong():
    picture = image()
    assert losses.photometric(picture, picture) == 0
    assert losses.structure(picture, picture) == 0
    assert losses.coverage(picture[..., 0], picture[..., 0]) == 0


@pytest.mark.parametrize("name", ["dissimilarity", "structure"])
def test_stand_ins_for_lpips_see_a_blurred_picture_of_the_right_level(name):
    y, x = torch.meshgrid(torch.arange(32.0), torch.arange(32.0), indexing="ij")
    sharp = (torch.sin(x) * torch.cos(y) > 0).double()[..., None].expand(32, 32, 3)
    blurred = torch.full_like(sharp, float(sharp.mean()))
    loss = getattr(losses, name)
    assert loss(sharp, sharp) == pytest.approx(0)
    assert loss(blurred, sharp) > 3 * loss(sharp * 0.9, sharp) > 0


def test_dissimilarity_has_the_gradient_of_its_value():
    here, there = image(0, 12, 12).requires_grad_(), image(1, 12, 12)
    assert torch.autograd.gradcheck(lambda i: losses.dissimilarity(i, there), here)
    tiny = losses.dissimilarity(here[:5, :5], there[:5, :5])
    assert tiny == 0


def test_photometric_and_coverage_are_mean_absolute_differences():
    here, there = torch.zeros(2, 2, 3), torch.zeros(2, 2, 3)
    there[0, 0] = torch.tensor([0.3, -0.6, 0.0])
    assert losses.photometric(here, there).item() == pytest.approx(0.9 / 12)
    assert losses.coverage(here[..., 0], there[..., 0]).item() == pytest.approx(0.3 / 4)


def test_structure_is_blind_to_levels():
    picture = image()
    assert losses.structure(picture, picture + 0.3).item() == pytest.approx(0, abs=1e-12)
    assert losses.structure(picture, picture.flip(0)) > 0


def test_structure_of_a_step_is_its_height_over_all_differences_at_each_scale():
    step = torch.zeros(8, 8, 3)
    step[:, 4:] = 1.0
    # Of 7, 3 and 1 differences along a row one is 1; along the columns none is.
    expected = (1 / 7 + 1 / 3 + 1) / 6
    flat = torch.zeros_like(step)
    assert losses.structure(step, flat).item() == pytest.approx(expected)


@pytest.mark.parametrize(("height", "width"), [(4, 4), (2, 1)])
def test_tiny_boxes_have_finite_structure(height, width):
    assert torch.isfinite(losses.structure(image(0, height, width), image(1, height, width)))


def test_gradients_are_those_of_differences():
    picture, target = image(height=7, width=6).requires_grad_(), image(1, 7, 6)
    assert torch.autograd.gradcheck(lambda x: losses.photometric(x, target), picture)
    assert torch.autograd.gradcheck(lambda x: losses.structure(x, target), picture)
    assert torch.autograd.gradcheck(lambda x: losses.coverage(x[..., 0], target[..., 0]), picture)
