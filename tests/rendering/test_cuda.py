"""The gsplat adapter: on a GPU against the kernel, elsewhere with a stand-in for gsplat."""

import gc
import sys
import weakref
from types import ModuleType

import pytest
import torch

from deblur_avatar.errors import ConfigError
from deblur_avatar.rendering import cuda
from deblur_avatar.rendering.conventions import EPS2D, NEAR_PLANE
from deblur_avatar.rendering.covariances import upper_triangles
from deblur_avatar.rendering.rasterize import rasterize

F64 = torch.float64


class StandIn:
    """What gsplat 1.5.3 does with the arguments we give it, by way of the reference."""

    def fully_fused_projection(
        self, means, covars, quats, scales, viewmats, Ks, width, height, eps2d, near_plane,
        opacities,
    ):  # fmt: skip
        assert quats is None
        assert scales is None
        B, N = means.shape[:2]
        assert covars.shape == (B, N, 6)
        assert opacities.shape == (B, N)
        assert viewmats.shape == (B, 1, 4, 4)
        assert Ks.shape == (B, 1, 3, 3)
        assert near_plane == NEAR_PLANE
        self.given = means, covars, opacities[0]
        self.camera = viewmats[0, 0], Ks[0, 0], width, height
        self.eps2d = eps2d
        found = self.reference(torch.zeros(N, 1, dtype=means.dtype))
        # A point on the way to the means, where gradients of the centres can be told to pass by.
        means2d = torch.zeros(B, 1, N, 2, dtype=means.dtype, requires_grad=True) * 1
        means2d.absgrad = torch.full_like(means2d, 7.0)
        radii = found.radii[:, None, :, None].expand(B, 1, N, 2)
        depths = torch.zeros(B, 1, N, dtype=means.dtype)
        return radii, means2d, depths, "conics", None

    def reference(self, colors):
        means, covars, opacities = self.given
        return rasterize(
            means, covars, opacities, colors, *self.camera,
            depth=True, eps2d=self.eps2d, backend="reference",
        )  # fmt: skip

    def isect_tiles(self, means2d, radii, depths, tile_size, tile_width, tile_height):
        width, height = self.camera[2:]
        assert (tile_width - 1) * tile_size < width <= tile_width * tile_size
        assert (tile_height - 1) * tile_size < height <= tile_height * tile_size
        return "tiles per Gaussian", "intersections", "Gaussians"

    def isect_offset_encode(self, isect_ids, n_images, tile_width, tile_height):
        assert isect_ids == "intersections"
        return torch.zeros(n_images, tile_height, tile_width)

    def rasterize_to_pixels(
        self, means2d, conics, colors, opacities, width, height, tile_size, isect_offsets,
        flatten_ids, absgrad,
    ):  # fmt: skip
        assert absgrad is True
        assert (conics, flatten_ids) == ("conics", "Gaussians")
        B, N = self.given[0].shape[:2]
        assert opacities.shape == (B, 1, N)
        assert colors.shape[:3] == (B, 1, N)
        assert isect_offsets.shape[:2] == (B, 1)
        with_depth = colors.shape[-1] > 3
        found = self.reference(colors[0, 0, :, :3])
        pictures = found.image
        if with_depth:
            pictures = torch.cat([pictures, found.depth[..., None]], -1)
        pictures = pictures + (means2d[..., 0] * 3).sum()
        return pictures[:, None], found.alpha[:, None, ..., None]


@pytest.fixture
def on_the_cpu(monkeypatch):
    monkeypatch.setattr(cuda, "_gsplat", StandIn)
    monkeypatch.setattr(cuda, "_check_place", lambda means: None)


def through_adapter(scene, eps2d=EPS2D):
    tensors = {name: t.requires_grad_() for name, t in scene._tensors(F64).items()}
    background = tensors.pop("background", None)
    found = cuda.rasterize(
        **tensors,
        viewmat=scene.viewmat,
        K=scene.K,
        width=scene.width,
        height=scene.height,
        background=background,
        average=scene.average,
        depth=scene.depth,
        eps2d=eps2d,
    )
    return found, tensors | ({"background": background} if background is not None else {})


@pytest.mark.parametrize("average", [False, True])
@pytest.mark.parametrize("six", [False, True])
def test_the_adapter_hands_everything_over_and_back(make_scene, on_the_cpu, average, six):
    scene = make_scene(poses=3).but(average=average, depth=True)
    if six:
        scene = scene.but(covars=upper_triangles(scene.covars))
    found, tensors = through_adapter(scene)
    expected = scene.differentiate("reference", F64)
    torch.testing.assert_close(found.image, expected["image"])
    torch.testing.assert_close(found.alpha, expected["alpha"])
    torch.testing.assert_close(found.depth, expected["depth"])
    torch.testing.assert_close(found.radii.double(), expected["radii"])
    generator = torch.Generator().manual_seed(99)
    outputs = (found.image, found.alpha, found.depth)
    pulls = [torch.randn(t.shape, generator=generator, dtype=F64) for t in outputs]
    sum((t * pull).sum() for t, pull in zip(outputs, pulls, strict=True)).backward()
    for name, tensor in tensors.items():
        torch.testing.assert_close(tensor.grad, expected[f"{name} gradient"])


def test_covariances_of_all_poses_may_be_shared(make_scene, on_the_cpu):
    scene = make_scene(poses=3)
    scene = scene.but(covars=scene.covars[0])
    found, tensors = through_adapter(scene)
    found.image.sum().backward()
    assert tensors["covars"].grad.shape == scene.covars.shape
    torch.testing.assert_close(found.image, scene.rasterize("reference").image)


def test_another_low_pass_is_handed_over(make_scene, on_the_cpu):
    scene = make_scene()
    found, _ = through_adapter(scene, eps2d=2.0)
    assert (found.image - scene.rasterize("reference").image).abs().max() > 0.01


def test_screen_statistics_hold_nothing_where_nothing_is_seen(make_scene, on_the_cpu):
    scene = make_scene(poses=2)
    means = scene.means.clone()
    means[:, ::2, 2] -= 6
    found, _ = through_adapter(scene.but(means=means))
    found.image.sum().backward()
    seen = found.radii > 0
    assert seen.any()
    assert (found.screen.means2d_absgrad[seen] == 7).all()
    assert (found.screen.means2d_absgrad[~seen] == 0).all()
    assert (found.screen.means2d_grad[~seen] == 0).all()
    assert (found.screen.means2d_grad[seen][:, 0] > 0).all()


@pytest.mark.parametrize("backward", [True, False])
def test_a_render_is_freed_with_its_graph(make_scene, on_the_cpu, backward):
    found, tensors = through_adapter(make_scene(poses=2))
    if backward:
        found.image.sum().backward()
    held = [weakref.ref(found.screen), weakref.ref(found.screen.means2d)]
    del found, tensors
    gc.collect()
    assert [ref() for ref in held] == [None, None]


def test_what_is_not_finite_is_refused_by_name(make_scene, on_the_cpu):
    scene = make_scene()
    with pytest.raises(ValueError, match="colors must be finite"):
        through_adapter(scene.but(colors=scene.colors * float("nan")))


def test_tensors_elsewhere_are_refused(make_scene):
    with pytest.raises(ValueError, match="on a GPU, got torch.float32 on cpu"):
        make_scene().rasterize("cuda", torch.float32)


class Uncompiled(ModuleType):
    """gsplat as it is where its kernels are not compiled."""

    def __init__(self, name, compiled):
        super().__init__(name)
        self.compiled = compiled

    @property
    def _C(self):
        if isinstance(self.compiled, Exception):
            raise self.compiled
        return self.compiled


@pytest.mark.parametrize(("compiled", "said"), [
    (None, "nvcc, which it did not find"),
    (RuntimeError("Error building extension 'gsplat_cuda'"), "cannot compile its kernels: Error"),
])  # fmt: skip
def test_a_gsplat_without_kernels_says_what_to_do(compiled, said, monkeypatch):
    for name in ("gsplat", "gsplat.cuda", "gsplat.cuda._backend"):
        monkeypatch.setitem(sys.modules, name, Uncompiled(name, compiled))
    with pytest.raises(ConfigError, match=f"{said}.*DEBLUR_AVATAR_DEVICE=cpu"):
        cuda._gsplat()


def test_a_gpu_without_gsplat_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(ConfigError, match="pip install .*cuda.*DEBLUR_AVATAR_DEVICE=cpu"):
        cuda._gsplat()


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
@pytest.mark.parametrize("poses", [1, 5])
@pytest.mark.parametrize("average", [False, True])
def test_on_a_gpu_picture_and_gradients_are_the_references(
    make_scene, assert_agree, poses, average
):
    pytest.importorskip("gsplat", reason="gsplat is not installed")
    scene = make_scene(poses=poses, gaussians=2000).but(average=average, depth=True)
    here = {name: t.cuda() for name, t in scene._tensors(torch.float32).items()}
    moved = scene.but(**here, viewmat=scene.viewmat.cuda(), K=scene.K.cuda())
    generator = torch.Generator().manual_seed(99)

    def pulls(*tensors):
        return [torch.randn(t.shape, generator=generator, dtype=F64) for t in tensors]

    tensors = {name: t.requires_grad_() for name, t in moved._tensors(torch.float32).items()}
    found = moved._call("cuda", tensors)
    outputs = {"image": found.image, "alpha": found.alpha, "depth": found.depth}
    amounts = pulls(*outputs.values())
    sum(
        (t * pull.to(t)).sum() for t, pull in zip(outputs.values(), amounts, strict=True)
    ).backward()
    outputs |= {f"{name} gradient": t.grad for name, t in tensors.items()}
    outputs["means2d gradient"] = found.screen.means2d_grad
    outputs["means2d absolute gradient"] = found.screen.means2d_absgrad
    outputs["radii"] = found.radii
    assert_agree(
        {name: t.detach().double().cpu() for name, t in outputs.items()},
        scene.differentiate("reference", F64),
    )
