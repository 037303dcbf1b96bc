import torch

from deblur_avatar.body_estimation.robust_costs import SATURATION, growing, saturating

NEAR, FAR = torch.tensor([1e-3]), torch.tensor([1e8])  # squares of standard deviations


def test_both_are_squares_near_zero():
    for cost in (growing, saturating):
        assert cost(torch.zeros(1)) == 0
        assert torch.allclose(cost(NEAR), NEAR, rtol=1e-3)


def test_far_off_one_costs_the_same_everywhere_and_the_other_grows_straight():
    assert torch.allclose(saturating(FAR), torch.tensor(SATURATION**2), rtol=1e-4)
    assert torch.allclose(saturating(torch.tensor(SATURATION**2)), torch.tensor(SATURATION**2 / 2))
    assert torch.allclose(growing(4 * FAR), 2 * growing(FAR), rtol=1e-3)
    assert torch.allclose(growing(FAR), 2 * FAR.sqrt(), rtol=1e-3)
