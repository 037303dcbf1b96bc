"""Where kernels take tensors, and those of a GPU on one: beside their twins in float64."""

import inspect
import math
from types import SimpleNamespace

import pytest
import torch

from deblur_avatar.avatars.knn_smoothness import knn_smoothness, knn_smoothness_reference
from deblur_avatar.rendering import native_calls
from deblur_avatar.rendering.covariance_factors import (
    covariance_factors,
    covariance_factors_reference,
    covariances,
    covariances_reference,
)
from deblur_avatar.rendering.native_build import BuildError
from deblur_avatar.rendering.native_calls import cuda_library_or_none, launch, place_of
from deblur_avatar.rendering.posing import CUDA_KERNEL, pose_gaussians, pose_gaussians_reference
from deblur_avatar.training.losses import coverage, photometric, structure
from deblur_avatar.training.picture_losses import picture_losses
from deblur_avatar.training.targets import Target
from tests.randomness import seeded

pytestmark = pytest.mark.portable

ON_A_GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
COUNT, POSES, JOINTS = 5000, 5, 24


def drawn(*size, seed=0):
    return torch.randn(*size, generator=seeded(seed + len(size)), dtype=torch.float64)


def test_kernels_take_float32_of_one_device():
    one = torch.zeros(2)
    assert place_of(one, one) == "cpu"
    assert place_of(one, one.double()) is None
    assert place_of(one.double()) is None
    assert place_of(one, torch.zeros(2, device="meta")) is None
    on_gpus = [
        SimpleNamespace(device=torch.device("cuda", index), dtype=torch.float32) for index in (0, 1)
    ]
    of_two = inspect.unwrap(place_of)
    assert of_two(on_gpus[0], on_gpus[0]) == "cuda"
    assert of_two(*on_gpus) is None


def test_a_gpu_without_a_compiler_computes_in_plain_torch_and_a_warning_says_why(monkeypatch):
    def fail(*asked):
        raise BuildError("no nvcc")

    monkeypatch.setattr(native_calls, "load_cuda_library", fail)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda: (9, 0))
    with pytest.warns(UserWarning, match="Gaussians are posed in plain torch, slowly: no nvcc"):
        assert cuda_library_or_none(CUDA_KERNEL, "Gaussians are posed") is None


def agree(kernel, twin, inputs, *others):
    """Values and gradients of a kernel on a GPU, and of its twin in float64 on the CPU."""
    results = []
    for function, place, dtype in (
        (kernel, "cuda", torch.float32),
        (twin, "cpu", torch.float64),
    ):
        given = [value.to(place, dtype).requires_grad_() for value in inputs]
        rest = [other.to(place) for other in others]
        found = function(*given, *rest)
        found = list(found) if isinstance(found, tuple) else [found]
        total = sum(
            (value * drawn(*value.shape, seed=9).to(value)).sum() if value.ndim else 3 * value
            for value in found
        )
        results.append([*found, *torch.autograd.grad(total, given)])
    for here, there in zip(*results, strict=True):
        size = max(there.abs().max().item(), 1e-12)
        assert here.device.type == "cuda"
        torch.testing.assert_close(
            here.detach().cpu().double(), there.detach(), rtol=1e-4, atol=2e-5 * size
        )


@pytest.mark.gpu
@ON_A_GPU
@pytest.mark.parametrize("learned", [False, True])
def test_posing(learned):
    inputs = [drawn(COUNT, 3), 0.1 * drawn(COUNT, 3, 3)]
    weights = drawn(COUNT, JOINTS).softmax(1)
    transforms = torch.eye(4).double() + 0.3 * drawn(POSES, JOINTS, 4, 4)
    transforms[..., 3, :] = torch.eye(4)[3].double()
    if learned:
        agree(pose_gaussians, pose_gaussians_reference, [*inputs, weights, transforms])
        return

    def with_given(function):
        return lambda a, b, t: function(a, b, weights.to(a), t)

    agree(with_given(pose_gaussians), with_given(pose_gaussians_reference), [*inputs, transforms])


@pytest.mark.gpu
@ON_A_GPU
def test_covariance_factors_with_turns_and_without():
    inputs = [drawn(COUNT, 4), drawn(COUNT, 3).abs(), drawn(COUNT, 3, seed=3)]
    for given in (inputs, inputs[:2]):
        agree(covariance_factors, covariance_factors_reference, given)
    agree(covariances, covariances_reference, [drawn(COUNT, 3, 3)])


@pytest.mark.gpu
@ON_A_GPU
@pytest.mark.parametrize("width", [1, 4])
def test_smoothness(width):
    near = torch.randint(0, COUNT, (COUNT, 4), generator=seeded(1))
    agree(knn_smoothness, knn_smoothness_reference, [drawn(COUNT, width)], near)
    near[7, 1] = COUNT
    assert torch.isnan(knn_smoothness(drawn(COUNT, width).float().cuda(), near.cuda()))


@pytest.mark.gpu
@ON_A_GPU
@pytest.mark.parametrize("space", ["srgb", "linear"])
@pytest.mark.parametrize("comparable", [False, True])
def test_losses_of_a_picture_are_those_on_the_cpu(space, comparable):
    height, width = 301, 260
    weights = {photometric: 1.0, structure: 0.3, coverage: 0.2}
    image, alpha = drawn(height, width, 3).sigmoid(), drawn(height, width).sigmoid()
    frame, matte = drawn(height, width, 3, seed=4).sigmoid(), drawn(height, width, seed=4).sigmoid()
    part = (drawn(height, width, seed=5) > 0).float() if comparable else None
    found = {}
    for place in ("cpu", "cuda"):
        given = [v.to(place, torch.float32).requires_grad_() for v in (image, alpha)]
        seen = Target(
            frame.float().to(place), matte.float().to(place),
            None if part is None else part.to(place), (13, 20, 200, 281), 1.0,
        )  # fmt: skip
        losses = list(picture_losses(*given, seen, space, weights).values())
        grads = torch.autograd.grad(losses[0] + 2 * losses[1] - losses[2], given)
        found[place] = [value.detach().cpu() for value in (*losses, *grads)]
    for there, here in zip(*found.values(), strict=True):
        size = there.abs().max().item()
        torch.testing.assert_close(here, there, rtol=1e-4, atol=1e-5 * size)
    given[0].data[50, 50, 1] = math.nan
    losses = list(picture_losses(*given, seen, space, weights).values())
    assert [bool(torch.isnan(loss)) for loss in losses] == [True, True, False]


@pytest.mark.gpu
@ON_A_GPU
def test_what_a_gpu_refuses_is_told_by_name():
    library = cuda_library_or_none(CUDA_KERNEL, "Gaussians are posed")
    assert library is not None
    values = torch.zeros(3, device="cuda")
    with pytest.raises(RuntimeError, match="the GPU refuses kernel 'pose'"):
        launch(library, "pose", [1, 2**45], values, values, values, values, values)
