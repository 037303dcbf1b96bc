import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.plain_avatar import PlainAvatar
from deblur_avatar.config.reading import parse
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.page.export import PageExport
from deblur_avatar.exports.registry import ExportParams
from deblur_avatar.motion.frame import FixedMotion
from tests.exports.browser import silent_page

PAGE = {
    "format": "page",
    "motions": ["own", "builtin:jumping_jacks"],
    "fps": 30.0,
    "seconds": 1.2,
    "pictures": 3,
}


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    with silent_page(browser, 780, 400) as opened:
        yield opened


@pytest.fixture(scope="session")
def page_exporter() -> PageExport:
    exporter = parse(ExportParams, PAGE, "export")
    assert isinstance(exporter, PageExport)
    return exporter


@pytest.fixture(scope="session")
def rough(painted: Callable[..., PlainAvatar]) -> Callable[..., PlainAvatar]:
    """An avatar of Gaussians of all shapes, no two of which are equally far from any camera."""

    def make(averaging_space: str = "srgb", count: int = 600) -> PlainAvatar:
        model = painted(averaging_space=averaging_space, count=count)
        generator = torch.Generator().manual_seed(5)
        with torch.no_grad():
            for values, size in (
                (model.gaussians.means, 0.01),
                (model.gaussians.quats, 0.5),
                (model.gaussians.log_scales, 0.4),
                (model.gaussians.opacity_logits, 2.0),
            ):
                values.add_(size * torch.randn(values.shape, generator=generator))
            # The page knows no early end: behind what is nearly opaque a Gaussian may count or not.
            model.gaussians.opacity_logits.clamp_(max=4.0)
        model.invalidate_neighbours()
        return model

    return make


@pytest.fixture(scope="session")
def fitted_run(observations, swinging) -> Callable[..., FittedRun]:
    """A run that left this avatar, moving as in the observations but farther."""

    def make(model: PlainAvatar, name: str = "capsules-lean", **others: Any) -> FittedRun:
        poses = swinging(5, 35.0)
        motion = FixedMotion(poses).to_artifact(poses.betas, observations.timestamps)
        return FittedRun(name, model.to_artifact(1), motion, observations, **others)

    return make


@pytest.fixture(scope="session")
def sharp(observations) -> Observations:
    """What the filming camera would have seen with no blur, brighter than what it saw."""
    lighter = observations.frames.clamp(min=60)
    return dataclasses.replace(observations, frames=lighter, exposure=0.0)


@pytest.fixture(scope="session")
def exported(page_exporter, tmp_path_factory) -> Callable[..., Path]:
    """Writes the page of a run."""
    folder = tmp_path_factory.mktemp("pages")

    def export(name: str, run: FittedRun) -> Path:
        page_exporter.export(run, folder / f"{name}.html")
        return folder / f"{name}.html"

    return export


@pytest.fixture(scope="session")
def beside(rough, fitted_run) -> FittedRun:
    """Another run of the same person."""
    return fitted_run(rough("linear"), "capsules-agnostic")


@pytest.fixture(scope="session")
def page_with_truth(rough, fitted_run, exported, beside, sharp) -> Path:
    """The page of two avatars whose true frames are known."""
    return exported("truth", fitted_run(rough(), sharp=sharp, beside=beside))


@pytest.fixture(scope="session")
def page_of_two(rough, fitted_run, exported, beside) -> Path:
    """The page of two avatars."""
    return exported("two", fitted_run(rough(), beside=beside))


@pytest.fixture(scope="session")
def page_file(rough, fitted_run, exported) -> Path:
    """The page of one avatar."""
    return exported("avatar", fitted_run(rough()))
