import pytest
import torch

from deblur_avatar.rendering.inputs import (
    check_camera,
    check_inputs,
    refuse_not_finite,
)


def arguments(**changes: object) -> dict[str, object]:
    B, N = 2, 4
    return {
        "means": torch.zeros(B, N, 3),
        "covars": torch.zeros(B, N, 6),
        "opacities": torch.zeros(N),
        "colors": torch.zeros(N, 3),
        "viewmat": torch.eye(4),
        "K": torch.eye(3),
        "width": 8,
        "height": 8,
        "background": torch.zeros(3),
    } | changes


@pytest.mark.parametrize("shape", [(2, 4, 6), (2, 4, 3, 3), (4, 6), (4, 3, 3)])
def test_covariances_may_be_whole_or_six_numbers_shared_or_not(shape):
    check_inputs(**arguments(covars=torch.zeros(shape)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"means": torch.zeros(4, 3)}, r"means must be \[B, N, 3\], got \[4, 3\]"),
        ({"means": torch.zeros(0, 4, 3)}, "at least one pose, got B = 0"),
        ({"covars": torch.zeros(2, 5, 6)}, r"B = 2 and N = 4 as in means, got \[2, 5, 6\]"),
        ({"covars": torch.zeros(3, 4, 6)}, "covars must be"),
        ({"opacities": torch.zeros(4, 1)}, r"opacities must be \[4\], got \[4, 1\]"),
        ({"colors": torch.zeros(4, 5)}, r"C from 1 to 4, got \[4, 5\]"),
        ({"colors": torch.zeros(2, 4, 3)}, r"colors must be \[N, C\]"),
        ({"viewmat": torch.eye(3)}, r"viewmat must be \[4, 4\], got \[3, 3\]"),
        ({"K": torch.eye(4)}, r"K must be \[3, 3\], got \[4, 4\]"),
        ({"background": torch.zeros(4)}, r"background must be \[3\], got \[4\]"),
        ({"colors": torch.zeros(4, 3).double()}, "colors must be torch.float32 as means is"),
        ({"means": torch.zeros(2, 4, 3).half()}, "float32 or float64, got torch.float16"),
        ({"opacities": torch.zeros(4, device="meta")}, "opacities must be on cpu as means is"),
        ({"width": 0}, "at least one pixel, got 0 x 8"),
        ({"viewmat": torch.eye(4).requires_grad_()}, "viewmat requires a gradient"),
        ({"K": torch.eye(3).requires_grad_()}, "keep the camera fixed"),
    ],
)
def test_what_does_not_fit_is_refused_with_what_would(changes, message):
    with pytest.raises(ValueError, match=message):
        check_inputs(**arguments(**changes))


def test_a_camera_is_a_rigid_motion_and_a_pinhole():
    check_camera(torch.eye(4), torch.eye(3))
    with pytest.raises(ValueError, match="last row of viewmat"):
        check_camera(torch.ones(4, 4), torch.eye(3))
    skewed = torch.eye(3)
    skewed[0, 1] = 0.1
    with pytest.raises(ValueError, match="K must be"):
        check_camera(torch.eye(4), skewed)
    with pytest.raises(ValueError, match="positive focal lengths"):
        check_camera(torch.eye(4), torch.diag(torch.tensor([-1.0, 1, 1])))
    with pytest.raises(ValueError, match="finite"):
        check_camera(torch.eye(4), torch.diag(torch.tensor([float("nan"), 1, 1])))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_what_is_not_finite_is_refused_by_name(value):
    bad = torch.zeros(3)
    bad[1] = value
    refuse_not_finite(good=torch.zeros(3), none=None)
    with pytest.raises(ValueError, match="bad must be finite"):
        refuse_not_finite(good=torch.zeros(3), none=None, bad=bad)
