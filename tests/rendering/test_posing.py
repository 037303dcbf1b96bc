import pytest
import torch

from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.rendering import posing
from deblur_avatar.rendering.covariance_factors import covariances
from deblur_avatar.rendering.posing import pose_gaussians, pose_gaussians_reference
from tests.gpu_sources import places_of
from tests.missing_compiler import check_a_warning_without_a_compiler
from tests.process_state import by_threads

pytestmark = pytest.mark.portable

place = places_of(posing)  # and of its kernel for a GPU
BOTH_PLACES = pytest.mark.usefixtures("place")

JOINTS = 24


def scene(count, poses, dtype=torch.float32):
    generator = torch.Generator().manual_seed(count + poses)

    def draw(*size):
        return torch.randn(*size, generator=generator, dtype=torch.float64)

    transforms = torch.eye(4).double().repeat(poses, JOINTS, 1, 1)
    transforms[..., :3, :3] = axis_angle_to_matrix(0.5 * draw(poses, JOINTS, 3))
    transforms[..., :3, 3] = 0.3 * draw(poses, JOINTS, 3)
    inputs = draw(count, 3), 0.1 * draw(count, 3, 3), draw(count, JOINTS).softmax(1), transforms
    return [value.to(dtype).requires_grad_() for value in inputs]


def with_gradients(function, inputs):
    """Outputs, and the gradients of an uneven sum of them."""
    posed = function(*inputs)
    generator = torch.Generator().manual_seed(0)
    total = torch.zeros((), dtype=inputs[0].dtype)
    for value in posed:
        weights = torch.randn(value.shape, generator=generator, dtype=torch.float64)
        total = total + (weights.to(value) * value).sum()
    return [*posed, *torch.autograd.grad(total, inputs)]


@BOTH_PLACES
@pytest.mark.parametrize("poses", [1, 5, 9])
@pytest.mark.parametrize("count", [0, 1, 3, 256, 700, 1025, 2050])  # up to three chunks
def test_the_kernel_agrees_with_its_slow_twin_in_value_and_gradient(count, poses):
    native = with_gradients(pose_gaussians, scene(count, poses))
    exact = with_gradients(pose_gaussians_reference, scene(count, poses, torch.float64))
    for fast, slow in zip(native, exact, strict=True):
        assert fast.shape == slow.shape
        size = slow.abs().max().item() if slow.numel() else 0.0
        torch.testing.assert_close(fast.double(), slow, rtol=1e-4, atol=1e-5 * size)


@pytest.mark.parametrize("poses", [1, 9])
def test_joints_of_no_weight_are_passed_over_without_a_trace(poses):
    means, covariance_factors, weights, transforms = scene(300, poses)
    few = (weights * (weights > 0.06)).detach()
    few[7] = 0  # of no joint at all
    assert (few == 0).float().mean() > 0.5
    learned = few.clone().requires_grad_()
    every = with_gradients(pose_gaussians, [means, covariance_factors, learned, transforms])
    own = with_gradients(
        lambda *x: pose_gaussians(*x[:2], few, x[2]), [means, covariance_factors, transforms]
    )
    for value, wanted in zip(own, [*every[:4], every[5]], strict=True):
        assert torch.equal(value, wanted)
    slow = with_gradients(
        pose_gaussians_reference, [means, covariance_factors, learned, transforms]
    )
    torch.testing.assert_close(every[4], slow[4], rtol=1e-3, atol=1e-4)


def test_it_is_the_kernel_that_float32_tensors_are_posed_by(monkeypatch):
    assert posing._library() is not None
    monkeypatch.setattr(posing, "pose_gaussians_reference", None)
    pose_gaussians(*scene(2, 1))


def test_the_number_of_threads_changes_no_bit():
    results = by_threads(lambda: with_gradients(pose_gaussians, scene(2000, 5)), 1, 2)
    for one, two in zip(*results, strict=True):
        assert torch.equal(one, two)


@BOTH_PLACES
def test_tensors_need_not_be_contiguous():
    means, covariance_factors, weights, transforms = (value.detach() for value in scene(30, 2))
    straight = pose_gaussians(means, covariance_factors, weights, transforms)
    strided = pose_gaussians(
        means.T.contiguous().T,
        covariance_factors.mT.contiguous().mT,
        weights.T.contiguous().T,
        transforms.mT.contiguous().mT,
    )
    for one, two in zip(straight, strided, strict=True):
        assert torch.equal(one, two)


def test_one_tensor_of_another_precision_is_never_read_as_float32():
    means, covariance_factors, weights, transforms = (value.detach() for value in scene(30, 2))
    given = [means, covariance_factors, weights, transforms]
    for place in range(4):
        mixed = [value.double() if i == place else value for i, value in enumerate(given)]
        with pytest.raises(RuntimeError, match="scalar type|same dtype"):
            pose_gaussians(*mixed)


@pytest.mark.parametrize("which", [1, 2, 3])
def test_tensors_that_do_not_fit_each_other_are_refused(which):
    """Also where shapes are not checked at every call, since the kernel reads past the shorter."""
    inputs = [value.detach() for value in scene(30, 2)]
    posing._check_shapes(*inputs)
    inputs[which] = inputs[which][:, :22] if which == 3 else inputs[which][:29]
    with pytest.raises(ValueError, match="30 means and 2. joints' transforms want"):
        posing._check_shapes(*inputs)


@BOTH_PLACES
def test_the_rest_pose_moves_nothing():
    means, covariance_factors, weights, _ = scene(20, 1)
    still = torch.eye(4).expand(3, JOINTS, 4, 4)
    posed, covars = pose_gaussians(means, covariance_factors, weights, still)
    torch.testing.assert_close(posed, means.expand(3, 20, 3))
    torch.testing.assert_close(covars, covariances(covariance_factors).expand(3, 20, 6))


def test_a_rigid_motion_of_all_joints_turns_covariances_and_moves_means():
    means, covariance_factors, weights, _ = scene(20, 1, torch.float64)
    rigid = torch.eye(4).double()
    rigid[:3, :3] = axis_angle_to_matrix(torch.tensor([0.4, -1.0, 0.3]).double())
    rigid[:3, 3] = torch.tensor([1.0, 2, 3])
    posed, covars = pose_gaussians_reference(
        means, covariance_factors, weights, rigid.expand(1, JOINTS, 4, 4)
    )
    torch.testing.assert_close(posed[0], means @ rigid[:3, :3].T + rigid[:3, 3])
    turned = rigid[:3, :3] @ covariance_factors @ covariance_factors.mT @ rigid[:3, :3].T
    rows, columns = torch.triu_indices(3, 3)
    torch.testing.assert_close(covars[0], turned[:, rows, columns])


def test_six_numbers_are_the_upper_triangle_of_the_spread_times_itself():
    covariance_factors = torch.tensor([[[1.0, 0, 0], [2, 3, 0], [0, 0, 4]]])
    # xx xy xz yy yz zz
    torch.testing.assert_close(
        covariances(covariance_factors), torch.tensor([[1.0, 2, 0, 13, 0, 16]])
    )


def test_the_slow_twin_has_the_gradient_of_differences():
    inputs = [value.detach().requires_grad_() for value in scene(2, 2, torch.float64)]
    inputs[2] = inputs[2].detach()[:, :3].requires_grad_()
    inputs[3] = inputs[3].detach()[:, :3].requires_grad_()
    assert torch.autograd.gradcheck(pose_gaussians_reference, inputs)


def test_without_a_compiler_gaussians_are_posed_in_plain_torch_and_a_warning_says_why(monkeypatch):
    native = pose_gaussians(*scene(50, 3))
    check_a_warning_without_a_compiler(posing, monkeypatch)
    monkeypatch.setattr(posing, "_library", lambda: None)
    plain = pose_gaussians(*scene(50, 3))
    for fast, slow in zip(native, plain, strict=True):
        torch.testing.assert_close(fast, slow)
    assert plain[0].grad_fn.name() != native[0].grad_fn.name()


def test_weights_that_are_not_learned_are_grouped_once_until_they_change(monkeypatch):
    grouped, calls = posing._grouped, []
    monkeypatch.setattr(posing, "_grouped", lambda *given: calls.append(1) or grouped(*given))
    means, factors, weights, transforms = (value.detach() for value in scene(300, 2))
    first = pose_gaussians(means, factors, weights, transforms)
    again = pose_gaussians(means, factors, weights, transforms)
    assert len(calls) == 1
    assert all(torch.equal(*pair) for pair in zip(first, again, strict=True))
    weights.copy_(weights.flip(1))
    turned = pose_gaussians(means, factors, weights, transforms)
    fresh = pose_gaussians(means, factors, weights.clone(), transforms)
    assert all(torch.equal(*pair) for pair in zip(turned, fresh, strict=True))
    assert not torch.equal(turned[0], first[0])
    assert len(calls) == 3
    del fresh
    learned = weights.clone().requires_grad_()
    for _ in range(2):
        pose_gaussians(means, factors, learned, transforms)
    assert len(calls) == 5
