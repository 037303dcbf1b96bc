import math

import pytest
import torch

from deblur_avatar.rendering import reference
from deblur_avatar.rendering.conventions import (
    EPS2D,
    MAX_ALPHA,
    MIN_ALPHA,
    eps2d_of,
)
from deblur_avatar.rendering.covariances import upper_triangles
from deblur_avatar.rendering.rasterize import rasterize

F64 = {"dtype": torch.float64}


def seen_along_the_axis(depths, opacities, colors, size=5, **options):
    """Gaussians of 1 cm on the viewing axis of a camera whose axis meets a pixel's centre."""
    n = len(depths)
    means = torch.zeros(1, n, 3, **F64)
    means[0, :, 2] = torch.tensor(depths, **F64)
    K = torch.tensor([[100.0, 0, size / 2], [0, 100, size / 2], [0, 0, 1]], **F64)
    return rasterize(
        means,
        1e-4 * torch.eye(3, **F64).expand(1, n, 3, 3),
        torch.tensor(opacities, **F64),
        torch.tensor(colors, **F64),
        torch.eye(4, **F64),
        K,
        size,
        size,
        backend="reference",
        **options,
    )


def test_one_gaussian_has_its_opacity_at_its_centre_and_falls_off_as_projected():
    found = seen_along_the_axis([2.0], [0.8], [[1.0, 0.5, 0.0]])
    variance = (100 / 2.0) ** 2 * 1e-4 + EPS2D
    beside = 0.8 * math.exp(-0.5 / variance)
    torch.testing.assert_close(found.image[0, 2, 2], 0.8 * torch.tensor([1, 0.5, 0], **F64))
    assert float(found.alpha[0, 2, 2]) == pytest.approx(0.8)
    assert float(found.alpha[0, 2, 3]) == pytest.approx(beside)
    assert float(found.alpha[0, 1, 2]) == pytest.approx(beside)


@pytest.mark.parametrize("eps2d", [EPS2D, 0.05])
def test_areas_are_what_pictures_of_one_gaussian_sum_up_to(eps2d):
    means, opacities = torch.tensor([[[0.01, -0.02, 2.0]]], **F64), torch.tensor([0.9], **F64)
    half = torch.tensor([[0.04, 0.0, 0.0], [0.02, 0.015, 0.0], [0.0, 0.01, 0.03]], **F64)
    covars = (half @ half.mT)[None]
    K = torch.tensor([[100.0, 0, 20], [0, 120.0, 20], [0, 0, 1]], **F64)
    scene = means, covars, opacities
    picture = rasterize(
        *scene, torch.ones(1, 1, **F64), torch.eye(4, **F64), K, 40, 40, backend="reference",
        eps2d=eps2d,
    )  # fmt: skip
    found = reference.project(*scene, torch.eye(4, **F64), K, 40, 40, eps2d).areas
    # Beyond where it is fainter than MIN_ALPHA nothing is drawn.
    drawn = 0.9 * float(found) * (1 - MIN_ALPHA / 0.9)
    assert float(picture.alpha.sum()) == pytest.approx(drawn, rel=5e-3)
    behind = reference.project(-means, *scene[1:], torch.eye(4, **F64), K, 40, 40, eps2d)
    assert float(behind.areas) == 0


def test_a_binned_picture_is_the_area_average_of_the_whole_one():
    def apart(eps2d):
        whole = seen_along_the_axis([2.0], [0.8], [[1.0]], size=40).image[0]
        average = torch.nn.functional.avg_pool2d(whole.permute(2, 0, 1)[None], 2)[0, 0]
        K = torch.tensor([[50.0, 0, 10], [0, 50.0, 10], [0, 0, 1]], **F64)
        means = torch.tensor([[[0.0, 0, 2]]], **F64)
        small = rasterize(
            means, 1e-4 * torch.eye(3, **F64)[None], torch.tensor([0.8], **F64),
            torch.ones(1, 1, **F64), torch.eye(4, **F64), K, 20, 20, backend="reference",
            eps2d=eps2d,
        )  # fmt: skip
        return float((small.image[0, ..., 0] - average).abs().max())

    assert eps2d_of(1.0) == EPS2D
    assert eps2d_of(2.0) == pytest.approx(0.1375)
    # The peak of so small a Gaussian is lower in the average, whatever the low-pass.
    assert apart(eps2d_of(2.0)) < 0.5 * apart(EPS2D)


def test_the_nearer_gaussian_covers_the_farther_one():
    found = seen_along_the_axis(
        *([3.0, 2.0], [0.5, 0.4], [[1.0], [0.0]]), depth=True, background=torch.ones(1, **F64)
    )
    assert float(found.image[0, 2, 2, 0]) == pytest.approx(0.6 * 0.5 * 1 + 0.6 * 0.5 * 1)
    assert float(found.alpha[0, 2, 2]) == pytest.approx(1 - 0.6 * 0.5)
    assert float(found.depth[0, 2, 2]) == pytest.approx(0.4 * 2 + 0.6 * 0.5 * 3)


def test_at_equal_depth_the_first_gaussian_is_in_front():
    found = seen_along_the_axis([2.0, 2.0], [0.5, 0.5], [[1.0], [0.0]])
    assert float(found.image[0, 2, 2, 0]) == pytest.approx(0.5)


def test_no_gaussian_is_more_opaque_than_the_limit():
    found = seen_along_the_axis([2.0], [1.0], [[1.0]])
    assert float(found.alpha[0, 2, 2]) == pytest.approx(MAX_ALPHA)


def test_what_is_fainter_than_the_limit_is_not_seen():
    assert float(seen_along_the_axis([2.0], [0.99 * MIN_ALPHA], [[1.0]]).alpha.abs().max()) == 0
    assert float(seen_along_the_axis([2.0], [1.01 * MIN_ALPHA], [[1.0]]).alpha.max()) > 0


def test_a_pixel_is_finished_before_it_would_become_opaque():
    # 0.999 twice would leave 1e-6: the second is left out, and so is all behind it.
    found = seen_along_the_axis([2.0, 3.0, 4.0], [1.0, 1.0, 0.5], [[0.0], [1.0], [1.0]])
    assert float(found.image[0, 2, 2, 0]) == 0
    assert float(found.alpha[0, 2, 2]) == pytest.approx(MAX_ALPHA)


def test_behind_the_camera_nothing_is_seen_and_nothing_pulls(make_scene):
    scene = make_scene()
    behind = scene.but(means=scene.means - torch.tensor([0, 0, 6.0], **F64))
    found = behind.differentiate("reference", torch.float64)
    assert found["radii"].max() == 0
    torch.testing.assert_close(
        found["image"], scene.background.expand_as(found["image"]), atol=0, rtol=0
    )
    for name in ("means", "covars", "opacities", "colors", "means2d"):
        assert found[f"{name} gradient"].abs().max() == 0


def test_moving_world_and_camera_together_changes_nothing(make_scene):
    scene = make_scene(poses=2)
    turn = torch.linalg.qr(torch.randn(3, 3, **F64)).Q
    turn = turn * turn.det()
    shift = torch.tensor([0.3, -2.0, 1.0], **F64)
    camera_from_moved = torch.eye(4, **F64)
    camera_from_moved[:3, :3] = scene.viewmat[:3, :3] @ turn.T
    camera_from_moved[:3, 3] = scene.viewmat[:3, 3] - camera_from_moved[:3, :3] @ shift
    moved = scene.but(
        means=scene.means @ turn.T + shift,
        covars=turn @ scene.covars @ turn.T,
        viewmat=camera_from_moved,
    )
    torch.testing.assert_close(
        moved.rasterize("reference").image, scene.rasterize("reference").image
    )


def test_the_order_of_gaussians_is_invisible(make_scene):
    scene = make_scene()
    order = torch.randperm(scene.means.shape[1])
    shuffled = scene.but(
        means=scene.means[:, order],
        covars=scene.covars[:, order],
        opacities=scene.opacities[order],
        colors=scene.colors[order],
    )
    torch.testing.assert_close(
        shuffled.rasterize("reference").image, scene.rasterize("reference").image
    )


def test_the_mean_picture_is_the_mean_of_the_pictures(make_scene):
    scene = make_scene(poses=3).but(depth=True)
    each, mean = scene.rasterize("reference"), scene.but(average=True).rasterize("reference")
    torch.testing.assert_close(mean.image, each.image.mean(0, keepdim=True))
    torch.testing.assert_close(mean.alpha, each.alpha.mean(0, keepdim=True))
    torch.testing.assert_close(mean.depth, each.depth.mean(0, keepdim=True))


def test_six_numbers_serve_as_well_as_a_matrix(make_scene):
    scene = make_scene()
    six = scene.but(covars=upper_triangles(scene.covars))
    torch.testing.assert_close(six.rasterize("reference").image, scene.rasterize("reference").image)


def test_looking_only_at_near_gaussians_changes_nothing(make_scene, monkeypatch):
    scene = make_scene()
    found = scene.rasterize("reference")
    monkeypatch.setattr(reference, "BLOCK", 1000)
    everything = scene.rasterize("reference")
    torch.testing.assert_close(found.image, everything.image, atol=1e-14, rtol=0)


def test_gradients_are_right(make_scene):
    # Faint, wide Gaussians, all of them visible everywhere: no pixel is near a threshold.
    scene = make_scene(gaussians=5, width=4, height=3, size=1.0).but(average=True, depth=True)
    scene = scene.but(opacities=0.1 + 0.3 * scene.opacities, means=0.2 * scene.means)
    scene = scene.but(covars=scene.covars + 0.5 * torch.eye(3, **F64))

    def draw(means, covars, opacities, colors, background):
        found = rasterize(
            *(means, 0.5 * (covars + covars.mT), opacities, colors, scene.viewmat, scene.K, 4, 3),
            background=background,
            depth=True,
            backend="reference",
        )
        assert found.alpha.min() > 0.1
        return found.image, found.alpha, found.depth

    names = ("means", "covars", "opacities", "colors", "background")
    inputs = [getattr(scene, name).clone().requires_grad_() for name in names]
    # Undefined gradients are autograd's own business, and reach hooks as None.
    assert torch.autograd.gradcheck(draw, inputs, check_undefined_grad=False)


def test_shifting_the_picture_is_what_the_screen_gradients_add_up_to(make_scene):
    scene = make_scene(poses=2)
    pull = torch.randn(2, scene.height, scene.width, 3, **F64)
    means = scene.means.clone().requires_grad_()
    found = scene.but(means=means)._call(
        "reference", scene._tensors(torch.float64) | {"means": means}
    )
    (found.image * pull).sum().backward()

    def loss(shift):
        K = scene.K.clone()
        K[0, 2] += shift
        return (scene.but(K=K).rasterize("reference").image * pull).sum()

    step = 1e-7
    expected = (loss(step) - loss(-step)) / (2 * step)
    assert float(found.screen.means2d_grad[..., 0].sum()) == pytest.approx(
        float(expected), rel=1e-4
    )


def test_absolute_screen_gradients_add_up_what_single_pixels_pull(make_scene):
    scene = make_scene(gaussians=20, width=4, height=3, size=0.3)
    single = torch.zeros(20, 2, **F64)
    for pixel in range(12):
        means = scene.means.clone().requires_grad_()
        tensors = scene._tensors(torch.float64) | {"means": means}
        found = scene._call("reference", tensors)
        found.alpha.flatten()[pixel].backward()
        single += found.screen.means2d_grad[0].abs()
    means = scene.means.clone().requires_grad_()
    found = scene._call("reference", scene._tensors(torch.float64) | {"means": means})
    found.alpha.sum().backward()
    torch.testing.assert_close(found.screen.means2d_absgrad[0], single)


def test_projection_is_gsplats(make_scene):
    theirs = pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")
    scene = make_scene(poses=2)
    radii, means2d, depths, conics, _ = theirs._fully_fused_projection(
        *(scene.means, scene.covars, scene.viewmat.expand(2, 1, 4, 4), scene.K.expand(2, 1, 3, 3)),
        *(scene.width, scene.height),
    )
    ours = reference.project(
        *(scene.means, scene.covars, torch.ones_like(scene.opacities), scene.viewmat, scene.K),
        *(scene.width, scene.height),
    )
    torch.testing.assert_close(ours.means2d, means2d[:, 0])
    torch.testing.assert_close(ours.depths, depths[:, 0])
    torch.testing.assert_close(ours.conics, conics[:, 0])
    torch.testing.assert_close(ours.radii, radii[:, 0].amax(-1))
