"""Scenes of random Gaussians, and the ways in which two rasterizations are compared."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.rendering.covariances import covariances
from deblur_avatar.rendering.rasterize import rasterize
from deblur_avatar.rendering.result import Rasterization


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Arguments of `rasterize`, in float64."""

    means: Tensor
    covars: Tensor
    opacities: Tensor
    colors: Tensor
    background: Tensor | None
    viewmat: Tensor
    K: Tensor
    width: int
    height: int
    average: bool = False
    depth: bool = False

    def but(self, **changes: object) -> "Scene":
        return replace(self, **changes)

    def rasterize(self, backend: str, dtype: torch.dtype = torch.float64) -> Rasterization:
        """Rasterize without gradients."""
        return self._call(backend, self._tensors(dtype))

    def differentiate(self, backend: str, dtype: torch.dtype) -> dict[str, Tensor]:
        """Rasterize, pull at every pixel by some random amount, return all results in float64."""
        tensors = {name: t.requires_grad_() for name, t in self._tensors(dtype).items()}
        result = self._call(backend, tensors)
        found = {"image": result.image, "alpha": result.alpha}
        if result.depth is not None:
            found["depth"] = result.depth
        generator = torch.Generator().manual_seed(99)
        loss = sum(
            (t * torch.randn(t.shape, generator=generator, dtype=torch.float64).to(dtype)).sum()
            for t in found.values()
        )
        loss.backward()
        found |= {f"{name} gradient": t.grad for name, t in tensors.items()}
        found["means2d gradient"] = result.screen.means2d_grad
        found["means2d absolute gradient"] = result.screen.means2d_absgrad
        found["radii"] = result.radii
        return {name: t.detach().double() for name, t in found.items()}

    def _tensors(self, dtype: torch.dtype) -> dict[str, Tensor]:
        names = ("means", "covars", "opacities", "colors", "background")
        tensors = {name: getattr(self, name) for name in names}
        return {
            name: t.detach().to(dtype, copy=True) for name, t in tensors.items() if t is not None
        }

    def _call(self, backend: str, tensors: dict[str, Tensor]) -> Rasterization:
        dtype = tensors["means"].dtype
        return rasterize(
            **tensors,
            viewmat=self.viewmat.to(dtype),
            K=self.K.to(dtype),
            width=self.width,
            height=self.height,
            average=self.average,
            depth=self.depth,
            backend=backend,
        )


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """The scenes are small; on a busy machine threads would only wait for each other."""
    with run.one_thread():
        yield


MakeScene = Callable[..., Scene]


@pytest.fixture
def make_scene() -> MakeScene:
    return random_scene


def random_scene(
    *,
    poses: int = 1,
    gaussians: int = 300,
    channels: int = 3,
    width: int = 50,
    height: int = 37,
    size: float = 0.06,
    seed: int = 0,
) -> Scene:
    """Gaussians in a ball of radius 1 m, three metres in front of a slightly turned camera."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, dtype=torch.float64)

    means = 2 * uniform(1, gaussians, 3) - 1 + 0.05 * (2 * uniform(poses, gaussians, 3) - 1)
    quats = 2 * uniform(gaussians, 4) - 1
    covars = covariances(quats, size * (0.2 + uniform(gaussians, 3)))
    angle = torch.tensor(0.15, dtype=torch.float64)
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[0, 0] = viewmat[2, 2] = angle.cos()
    viewmat[0, 2], viewmat[2, 0] = angle.sin(), -angle.sin()
    viewmat[:3, 3] = torch.tensor([0.05, -0.1, 3.0], dtype=torch.float64)
    focal = 1.3 * max(width, height)
    K = torch.tensor(
        [[focal, 0, width / 2 + 1.3], [0, 1.05 * focal, height / 2 - 0.7], [0, 0, 1]],
        dtype=torch.float64,
    )
    return Scene(
        means=means,
        covars=covars * (0.7 + 0.6 * uniform(poses, 1, 1, 1)),
        opacities=uniform(gaussians),
        colors=uniform(gaussians, channels),
        background=uniform(channels),
        viewmat=viewmat,
        K=K,
        width=width,
        height=height,
    )


def relative_error(found: Tensor, expected: Tensor) -> float:
    """Length of the difference over length of the expectation; 0 where both vanish."""
    difference = (found - expected).norm()
    return float(difference / expected.norm()) if difference > 0 else 0.0


@pytest.fixture
def assert_agree() -> Callable[[dict[str, Tensor], dict[str, Tensor]], None]:
    return agree


def agree(found: dict[str, Tensor], expected: dict[str, Tensor]) -> None:
    """1e-4 forward and 1e-3 backward, as the backends promise."""
    assert found.keys() == expected.keys()
    for name, value in found.items():
        limit = 1e-3 if name.endswith("gradient") else 1e-4
        assert value.shape == expected[name].shape, name
        assert value.isfinite().all(), name
        if name == "radii":  # rounded up: a last bit may tip it over
            assert ((value - expected[name]).abs() <= 1).all()
            assert (value != expected[name]).sum() <= 0.01 * value.numel()
        else:
            assert relative_error(value, expected[name]) < limit, name
