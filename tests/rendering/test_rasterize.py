"""Which backend a call reaches, and what all of them share."""

import warnings

import pytest
import torch

from deblur_avatar.rendering import cpu, reference
from deblur_avatar.rendering import rasterize as rasterizers
from deblur_avatar.rendering.native_build import BuildError
from deblur_avatar.rendering.rasterize import rasterize

pytestmark = pytest.mark.portable


@pytest.fixture
def reached(monkeypatch):
    """Names of the backends that were called, which then draw by the reference."""
    names = []
    draw = reference.rasterize

    def remember(name):
        def rasterize_and_remember(*args, **kwargs):
            names.append(name)
            return draw(*args, **kwargs)

        return rasterize_and_remember

    monkeypatch.delenv(rasterizers.BACKEND_VARIABLE, raising=False)
    monkeypatch.setattr(cpu, "rasterize", remember("cpu"))
    monkeypatch.setattr(reference, "rasterize", remember("reference"))
    monkeypatch.setattr(rasterizers, "_compiles", lambda: True)
    return names


def draw(make_scene, dtype=torch.float32, **options):
    scene = make_scene(gaussians=3, width=4, height=4)
    return rasterize(
        **scene._tensors(dtype),
        viewmat=scene.viewmat.to(dtype),
        K=scene.K.to(dtype),
        width=4,
        height=4,
        **options,
    )


def test_tensors_on_the_cpu_reach_the_kernel(make_scene, reached):
    draw(make_scene)
    assert reached == ["cpu"]


def test_double_precision_reaches_the_reference(make_scene, reached):
    draw(make_scene, torch.float64)
    assert reached == ["reference"]


def test_the_environment_beats_the_device(make_scene, reached, monkeypatch):
    monkeypatch.setenv(rasterizers.BACKEND_VARIABLE, "reference")
    draw(make_scene)
    assert reached == ["reference"]


def test_the_argument_beats_the_environment(make_scene, reached, monkeypatch):
    monkeypatch.setenv(rasterizers.BACKEND_VARIABLE, "reference")
    draw(make_scene, backend="cpu")
    assert reached == ["cpu"]


def test_an_unknown_backend_is_refused_by_where_it_was_named(make_scene, monkeypatch):
    with pytest.raises(ValueError, match="backend must be one of reference, cpu, cuda, got 'gpu'"):
        draw(make_scene, backend="gpu")
    monkeypatch.setenv(rasterizers.BACKEND_VARIABLE, "gpu")
    with pytest.raises(ValueError, match="DEBLUR_AVATAR_RASTERIZER must be one of"):
        draw(make_scene)


def test_without_a_compiler_the_reference_takes_over_with_one_warning(make_scene, monkeypatch):
    def fail():
        raise BuildError("no C++ compiler")

    monkeypatch.delenv(rasterizers.BACKEND_VARIABLE, raising=False)
    monkeypatch.setattr(cpu, "kernel", fail)
    rasterizers._compiles.cache_clear()
    try:
        with pytest.warns(UserWarning, match="the reference takes over.*no C.. compiler"):
            first = draw(make_scene)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            second = draw(make_scene)
    finally:
        rasterizers._compiles.cache_clear()
    assert torch.equal(first.image, second.image)


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_screen_statistics_wait_for_a_backward_pass(make_scene, backend):
    result = draw(make_scene, backend=backend)
    with pytest.raises(RuntimeError, match="filled by a backward pass"):
        _ = result.screen.means2d_grad


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_depth_is_made_on_demand(make_scene, backend):
    assert draw(make_scene, backend=backend).depth is None
    assert draw(make_scene, backend=backend, depth=True).depth.shape == (1, 4, 4)


def test_a_camera_that_is_none_is_refused(make_scene):
    scene = make_scene(gaussians=3)
    with pytest.raises(ValueError, match="last row of viewmat"):
        scene.but(viewmat=2 * scene.viewmat).rasterize("reference")
