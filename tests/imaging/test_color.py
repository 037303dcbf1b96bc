import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb

from deblur_avatar.imaging.color import (
    LINEAR_KNEE,
    SRGB_KNEE,
    linear_to_srgb,
    srgb_to_linear,
)

pytestmark = pytest.mark.portable


def test_the_curve_is_the_one_other_programs_use():
    codes = torch.linspace(0, 1, 256, dtype=torch.float64).expand(1, 3, 1, 256)
    light = srgb_to_linear(codes)
    torch.testing.assert_close(light, rgb_to_linear_rgb(codes), atol=1e-9, rtol=0)
    torch.testing.assert_close(linear_to_srgb(codes), linear_rgb_to_rgb(codes), atol=1e-9, rtol=0)


def test_half_the_light_of_white_is_code_188():
    half = linear_to_srgb(torch.tensor([0.5]))
    assert round(float(half) * 255) == 188


def test_black_stays_black_and_white_stays_white():
    ends = torch.tensor([0.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(srgb_to_linear(ends), ends)
    torch.testing.assert_close(linear_to_srgb(ends), ends)


@given(st.floats(-0.5, 2.0))
def test_there_and_back_is_the_identity(value: float):
    srgb = torch.tensor([value], dtype=torch.float64)
    # The standard's rounded constants leave a step of 2e-7 at the knee.
    torch.testing.assert_close(linear_to_srgb(srgb_to_linear(srgb)), srgb, atol=1e-6, rtol=0)


@pytest.mark.parametrize("curve", [srgb_to_linear, linear_to_srgb])
def test_gradients_are_right_on_both_pieces(curve):
    values = torch.tensor([-0.2, 0.001, 0.02, 0.3, 0.9, 1.4], dtype=torch.float64)
    assert torch.autograd.gradcheck(curve, values.requires_grad_())


@pytest.mark.parametrize("curve", [srgb_to_linear, linear_to_srgb])
def test_gradients_are_finite_at_zero_below_it_and_at_the_knees(curve):
    values = torch.tensor([-1.0, 0.0, LINEAR_KNEE, SRGB_KNEE], requires_grad=True)
    curve(values).sum().backward()
    assert values.grad is not None
    assert torch.isfinite(values.grad).all()
    assert (values.grad > 0).all()
