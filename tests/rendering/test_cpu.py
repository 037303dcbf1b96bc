"""The native kernel against the reference, and what only the kernel promises."""

import os

import pytest
import torch

from deblur_avatar.rendering import cpu, native_build
from deblur_avatar.rendering.covariances import upper_triangles
from deblur_avatar.rendering.rasterize import rasterize
from tests.process_state import by_threads

pytestmark = pytest.mark.portable

F32, F64 = torch.float32, torch.float64


@pytest.fixture(autouse=True)
def _needs_a_compiler():
    try:
        cpu.kernel()
    except native_build.BuildError as error:
        pytest.skip(f"the kernel cannot be built here: {error}")


@pytest.fixture
def assert_parity(assert_agree):
    def check(scene):
        assert_agree(scene.differentiate("cpu", F32), scene.differentiate("reference", F64))

    return check


@pytest.mark.parametrize("poses", [1, 5, 9])
@pytest.mark.parametrize("average", [False, True])
def test_picture_and_gradients_are_the_references(make_scene, assert_parity, poses, average):
    assert_parity(make_scene(poses=poses, seed=poses).but(average=average))


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("depth", [False, True])
def test_so_they_are_for_any_number_of_channels(make_scene, assert_parity, channels, depth):
    assert_parity(make_scene(poses=2, channels=channels).but(depth=depth, average=depth))


def test_so_they_are_for_five_thousand_gaussians(make_scene, assert_parity):
    assert_parity(make_scene(gaussians=5000, width=48, height=48, size=0.02))


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 40), (33, 1), (16, 16), (17, 31)])
def test_so_they_are_for_pictures_of_any_size(make_scene, assert_parity, width, height):
    assert_parity(make_scene(width=width, height=height))


def test_so_they_are_where_most_tiles_are_empty(make_scene, assert_parity):
    scene = make_scene(gaussians=30, width=200, height=150)
    assert_parity(scene.but(means=0.1 * scene.means))


def test_so_they_are_with_gaussians_behind_the_camera_and_at_its_plane(make_scene, assert_parity):
    scene = make_scene()
    means = scene.means.clone()
    means[0, ::3, 2] -= 4  # behind
    means[0, 1] = -scene.viewmat[:3, :3].T @ scene.viewmat[:3, 3]  # in the lens
    assert_parity(scene.but(means=means))


def test_so_they_are_with_gaussians_outside_the_picture(make_scene, assert_parity):
    scene = make_scene()
    assert_parity(scene.but(means=4 * scene.means))


def test_so_they_are_with_gaussians_that_cover_the_picture(make_scene, assert_parity):
    scene = make_scene(gaussians=12, width=70, height=50, size=1.5)
    assert_parity(scene.but(opacities=0.3 * scene.opacities))


def test_so_they_are_with_more_gaussians_in_a_tile_than_a_segment_holds(make_scene, assert_parity):
    scene = make_scene(gaussians=1500, width=20, height=18)
    assert_parity(scene.but(opacities=0.02 + 0.01 * scene.opacities))


def test_so_they_are_where_pixels_are_finished_early(make_scene, assert_parity):
    scene = make_scene(gaussians=1500, width=20, height=18, size=0.3)
    assert_parity(scene.but(opacities=0.6 + 0.4 * scene.opacities))


def test_so_they_are_with_coincident_depths(make_scene, assert_parity):
    scene = make_scene(gaussians=100)
    means = scene.means.clone()
    means[..., 2] = (means[..., 2] * 2).round() / 2
    viewmat = torch.eye(4, dtype=F64)
    viewmat[2, 3] = 3
    assert_parity(scene.but(means=means, viewmat=viewmat))


def test_so_they_are_with_opacities_of_zero_and_one(make_scene, assert_parity):
    scene = make_scene(gaussians=100)
    assert_parity(scene.but(opacities=scene.opacities.round()))


@pytest.mark.parametrize("gaussians", [0, 1, 15, 17])
def test_so_they_are_for_few_gaussians_or_none(make_scene, assert_parity, gaussians):
    assert_parity(make_scene(poses=2, gaussians=gaussians, size=0.3))


def test_so_they_are_without_a_background(make_scene, assert_parity):
    assert_parity(make_scene().but(background=None))


def test_so_they_are_for_six_numbers_a_covariance(make_scene, assert_parity):
    scene = make_scene(poses=2)
    assert_parity(scene.but(covars=upper_triangles(scene.covars)))


@pytest.mark.parametrize("six", [False, True])
def test_so_they_are_for_covariances_shared_by_all_poses(make_scene, assert_parity, six):
    covars = make_scene().covars[0]
    scene = make_scene(poses=5)
    assert_parity(scene.but(covars=upper_triangles(covars) if six else covars, average=True))


def test_so_they_are_when_poses_are_differentiated_one_by_one(
    make_scene, assert_parity, monkeypatch
):
    monkeypatch.setattr(cpu, "SLOT_CAPACITY", 1)
    scene = make_scene(poses=5)
    assert_parity(scene.but(covars=scene.covars[0], average=True))


@pytest.mark.parametrize("flags", ["-march=x86-64", "-march=x86-64-v3"])
def test_so_they_are_for_narrower_vectors(make_scene, assert_parity, monkeypatch, flags):
    others = os.environ.get(native_build.FLAGS_VARIABLE, "")  # sanitizers, say
    monkeypatch.setenv(native_build.FLAGS_VARIABLE, f"{others} {flags}")
    try:
        narrow = cpu.Kernel()
    except native_build.BuildError:
        pytest.skip(f"the compiler knows no {flags}")
    monkeypatch.setattr(cpu, "kernel", lambda: narrow)
    assert_parity(make_scene(poses=3).but(average=True, depth=True))


def test_the_result_does_not_depend_on_run_or_threads(make_scene):
    scene = make_scene(poses=3, gaussians=2000).but(average=True)
    results = by_threads(lambda: scene.differentiate("cpu", F32), 1, 1, 2, 3, 7)
    for result in results[1:]:
        for name, value in result.items():
            assert torch.equal(value, results[0][name]), name


def test_without_gradients_the_picture_is_the_same(make_scene):
    scene = make_scene(poses=2)
    with_gradients = scene.differentiate("cpu", F32)["image"]
    assert torch.equal(scene.rasterize("cpu", F32).image.double(), with_gradients)


def test_memory_layout_is_invisible(make_scene):
    scene = make_scene(poses=3)
    strided = scene.but(
        means=scene.means.transpose(0, 1).contiguous().transpose(0, 1),
        covars=scene.covars.mT,
        colors=scene.colors.T.contiguous().T,
        opacities=scene.opacities.repeat_interleave(2)[::2],
        K=scene.K.T.contiguous().T,
    )
    found, expected = strided.differentiate("cpu", F32), scene.differentiate("cpu", F32)
    for name, value in found.items():
        assert torch.equal(value, expected[name]), name


@pytest.mark.parametrize("lay_out", [lambda t: t[:1].expand(3), lambda t: t.repeat(2)[::2]])
def test_a_background_in_any_layout_lives_until_gradients_are_taken(make_scene, lay_out):
    scene, grads = make_scene(), []
    for strided in (True, False):
        tensors = scene._tensors(F32)
        background = lay_out(tensors["background"])
        tensors["background"] = background if strided else background.contiguous()
        tensors["opacities"].requires_grad_()
        image = scene._call("cpu", tensors).image
        kept = [torch.full((3,), 1e6) for _ in range(2000)]  # take what was given back
        image.sum().backward()
        assert kept
        grads.append(tensors["opacities"].grad)
    assert torch.equal(*grads)


def test_expanded_gradients_are_understood(make_scene):
    scene = make_scene()
    tensors = {name: t.requires_grad_() for name, t in scene._tensors(F32).items()}
    scene._call("cpu", tensors).image.sum().backward()
    spelt_out = {name: t.requires_grad_() for name, t in scene._tensors(F32).items()}
    image = scene._call("cpu", spelt_out).image
    image.backward(torch.ones_like(image))
    for name, tensor in tensors.items():
        assert torch.equal(tensor.grad, spelt_out[name].grad), name


@pytest.mark.parametrize("output", ["image", "alpha", "depth"])
def test_each_output_may_be_pulled_alone(make_scene, output):
    scene = make_scene(poses=2).but(depth=True)
    grads = {}
    for backend, dtype in (("cpu", F32), ("reference", F64)):
        tensors = scene._tensors(dtype)
        tensors["means"].requires_grad_()
        getattr(scene._call(backend, tensors), output).sum().backward()
        grads[backend] = tensors["means"].grad.double()
    torch.testing.assert_close(grads["cpu"], grads["reference"], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", ["means", "covars", "opacities", "colors", "background"])
def test_only_the_gradients_asked_for_are_made(make_scene, name):
    scene = make_scene(poses=2).but(average=True)
    expected = scene.differentiate("cpu", F32)[f"{name} gradient"]
    tensors = scene._tensors(F32)
    tensors[name].requires_grad_()
    found = scene._call("cpu", tensors)
    generator = torch.Generator().manual_seed(99)
    pulls = [
        torch.randn(t.shape, generator=generator, dtype=F64).float()
        for t in (found.image, found.alpha)
    ]
    ((found.image * pulls[0]).sum() + (found.alpha * pulls[1]).sum()).backward()
    torch.testing.assert_close(tensors[name].grad.double(), expected)
    assert all(t.grad is None for other, t in tensors.items() if other != name)


def test_several_backward_passes_add_up(make_scene):
    scene = make_scene()
    tensors = scene._tensors(F32)
    tensors["means"].requires_grad_()
    found = scene._call("cpu", tensors)
    found.alpha.sum().backward(retain_graph=True)
    once = found.screen.means2d_grad.clone()
    found.alpha.sum().backward()
    torch.testing.assert_close(found.screen.means2d_grad, 2 * once)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["means", "covars", "opacities", "colors", "background"])
def test_what_is_not_finite_is_refused_by_name(make_scene, name, value):
    tensors = make_scene(poses=2)._tensors(F32)
    tensors[name].view(-1)[-1] = value
    with pytest.raises(ValueError, match=f"{name} must be finite"):
        make_scene(poses=2)._call("cpu", tensors)


@pytest.mark.parametrize("size", [1e10, 1e19, 1e30])
def test_absurd_numbers_do_no_harm(make_scene, size):
    scene = make_scene(poses=2)
    for huge in ({"means": scene.means * size}, {"covars": scene.covars * size}):
        found = scene.but(**huge).differentiate("cpu", F32)
        assert found["image"].isfinite().all()


def test_not_a_number_from_behind_reaches_no_gaussian_that_is_not_seen(make_scene):
    scene = make_scene()
    means = scene.means.clone()
    means[0, ::2, 2] -= 6
    tensors = scene.but(means=means)._tensors(F32)
    tensors["means"].requires_grad_()
    (scene._call("cpu", tensors).image * float("nan")).sum().backward()
    assert tensors["means"].grad[0, ::2].isfinite().all()


def test_double_precision_is_sent_to_the_reference(make_scene):
    with pytest.raises(ValueError, match="computes in float32 on the CPU.*'reference' takes any"):
        make_scene().rasterize("cpu", F64)


def test_too_large_a_picture_is_refused(make_scene):
    with pytest.raises(ValueError, match="too much for the cpu backend"):
        make_scene().but(width=2**20, height=1).rasterize("cpu", F32)


def test_loading_the_kernel_leaves_small_numbers_alone():
    cpu.kernel()
    assert float(torch.tensor([1e-40]) * 1) > 0


def test_a_rasterization_can_be_kept_past_its_inputs(make_scene):
    scene = make_scene()
    tensors = scene._tensors(F32)
    for tensor in tensors.values():
        tensor.requires_grad_()
    image = rasterize(
        *(tensors["means"] * 1, tensors["covars"] * 1, tensors["opacities"] * 1),
        *(tensors["colors"] * 1, scene.viewmat.float(), scene.K.float()),
        *(scene.width, scene.height),
        backend="cpu",
    ).image
    junk = [torch.full((4000,), float("nan")) for _ in range(50)]
    image.sum().backward()
    assert junk
    assert tensors["means"].grad.isfinite().all()
