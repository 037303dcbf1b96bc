import hashlib
import logging
import os
from pathlib import Path

import pytest
import torch
from torch import nn

from deblur_avatar.errors import ConfigError
from deblur_avatar.imaging import lpips
from deblur_avatar.imaging.lpips import (
    Lpips,
    load_lpips,
    lpips_vgg,
)

HEADS = os.environ.get(lpips.HEADS_VARIABLE)
WEIGHTS = os.environ.get(lpips.WEIGHTS_VARIABLE)
PUBLISHED = lpips.HEADS_SHA256


@pytest.fixture(scope="module")
def model() -> Lpips:
    """Random weights that keep pictures apart through all thirteen layers, as trained ones do."""
    torch.manual_seed(0)
    model = Lpips()
    for layer in model.features:
        if isinstance(layer, nn.Conv2d):
            nn.init.kaiming_normal_(layer.weight)
            nn.init.zeros_(layer.bias)
    return model


@pytest.fixture
def files(model: Lpips, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Random weights under torchvision's and the LPIPS package's names, as if published."""
    trunk = {f"features.{name}": value for name, value in model.features.state_dict().items()}
    heads = {f"lin{index}.model.1.weight": head for index, head in enumerate(model.heads)}
    torch.save({**trunk, "classifier.0.weight": torch.zeros(2)}, tmp_path / "vgg16.pth")
    torch.save(heads, tmp_path / "heads.pth")
    for name, constant in (("vgg16.pth", "WEIGHTS_SHA256"), ("heads.pth", "HEADS_SHA256")):
        digest = hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()
        monkeypatch.setattr(lpips, constant, digest)
    return tmp_path / "vgg16.pth", tmp_path / "heads.pth"


def pictures(count: int = 2, size: int = 24) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    truth = torch.rand(count, size, size, 3, generator=generator)
    return (truth + 0.1 * torch.randn(truth.shape, generator=generator)).clamp(0, 1), truth


def naive_distance(model: Lpips, a: torch.Tensor, b: torch.Tensor) -> float:
    """The published recipe written out for one pair, with none of the module's own functions."""
    after_relu = (3, 8, 15, 22, 29)  # of torchvision's vgg16().features

    def maps(image: torch.Tensor) -> list[torch.Tensor]:
        shift = torch.tensor([-0.030, -0.088, -0.188])
        scale = torch.tensor([0.458, 0.448, 0.450])
        x = ((image * 2 - 1 - shift) / scale).permute(2, 0, 1)[None]
        seen = []
        for index, layer in enumerate(model.features):
            x = layer(x)
            if index in after_relu:
                seen.append(x[0])
        return seen

    total = 0.0
    for x, y, head in zip(maps(a), maps(b), model.heads, strict=True):
        at_pixels = []
        for row in range(x.shape[1]):
            for column in range(x.shape[2]):
                p, q = x[:, row, column], y[:, row, column]
                difference = p / p.norm() - q / q.norm()
                at_pixels.append(float((head.flatten() * difference**2).sum()))
        total += sum(at_pixels) / len(at_pixels)
    return total


def test_the_trunk_is_torchvisions_vgg16_layer_by_layer(model):
    convolutions = [i for i, x in enumerate(model.features) if isinstance(x, nn.Conv2d)]
    assert convolutions == [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28]
    weights = sum(x.numel() for x in model.features.state_dict().values())
    assert weights == 14_714_688  # torchvision's count of vgg16().features


def test_the_distance_is_the_published_recipe(model):
    render, truth = pictures(1)
    assert float(model(render, truth)) == pytest.approx(
        naive_distance(model, render[0], truth[0]), rel=1e-4
    )


def test_pictures_are_normalised_as_imagenets_were():
    mean, deviation = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    torch.testing.assert_close(torch.tensor(lpips.SHIFT), 2 * mean - 1, atol=1e-6, rtol=0)
    torch.testing.assert_close(torch.tensor(lpips.SCALE), 2 * deviation, atol=1e-6, rtol=0)


def test_equal_pictures_are_at_distance_zero_and_others_are_not(model):
    render, truth = pictures()
    assert model(truth, truth).abs().max() == 0
    assert (model(render, truth) > 0).all()


def test_the_distance_is_the_same_both_ways_and_for_each_picture_alone(model):
    render, truth = pictures()
    both = model(render, truth)
    torch.testing.assert_close(model(truth, render), both)
    alone = torch.cat([model(render[i : i + 1], truth[i : i + 1]) for i in range(2)])
    torch.testing.assert_close(alone, both)


def test_a_fitting_loop_can_follow_its_gradient(model):
    render, truth = pictures()
    render.requires_grad_()
    model(render, truth).sum().backward()
    assert torch.isfinite(render.grad).all()
    assert render.grad.abs().max() > 0


def test_weights_are_read_under_their_published_names(files, model, monkeypatch):
    render, truth = pictures()
    monkeypatch.setenv(lpips.WEIGHTS_VARIABLE, str(files[0]))
    monkeypatch.setenv(lpips.HEADS_VARIABLE, str(files[1]))
    torch.testing.assert_close(lpips_vgg(render, truth), model(render, truth).double())


def test_without_weights_it_is_not_measured_and_says_so_once(monkeypatch, caplog):
    monkeypatch.delenv(lpips.WEIGHTS_VARIABLE, raising=False)
    lpips._configured.cache_clear()
    with caplog.at_level(logging.WARNING):
        assert lpips_vgg(*pictures()).isnan().all()
        lpips_vgg(*pictures())
    assert [record.message for record in caplog.records] == [
        "lpips_vgg is not measured: set DEBLUR_AVATAR_LPIPS_WEIGHTS and DEBLUR_AVATAR_LPIPS_HEADS"
    ]


def test_a_picture_too_small_for_the_trunk_is_not_measured(files, monkeypatch):
    monkeypatch.setenv(lpips.WEIGHTS_VARIABLE, str(files[0]))
    monkeypatch.setenv(lpips.HEADS_VARIABLE, str(files[1]))
    assert lpips_vgg(*pictures(size=15)).isnan().all()
    assert lpips_vgg(*pictures(size=16)).isfinite().all()


def test_wrong_files_are_refused(files, tmp_path):
    with pytest.raises(ConfigError, match=r"WEIGHTS: cannot read .*missing\.pth: No such file"):
        load_lpips(tmp_path / "missing.pth", files[1])
    with pytest.raises(ConfigError, match=r"WEIGHTS: .*heads\.pth is not the published file"):
        load_lpips(files[1], files[1])
    with pytest.raises(ConfigError, match=r"HEADS: .*vgg16\.pth is not the published file"):
        load_lpips(files[0], files[0])


@pytest.mark.skipif(not HEADS, reason=f"{lpips.HEADS_VARIABLE} does not name the published heads")
def test_the_published_heads_fit(files, monkeypatch):
    monkeypatch.setattr(lpips, "HEADS_SHA256", PUBLISHED)
    published = load_lpips(files[0], Path(str(HEADS)))
    assert all(bool((head >= 0).all()) for head in published.heads)
    assert len({float(head.sum()) for head in published.heads}) == 5


@pytest.mark.skipif(not (WEIGHTS and HEADS), reason=f"{lpips.WEIGHTS_VARIABLE} is not set")
def test_real_weights_rank_a_blurred_picture_as_worse_than_a_brighter_one():
    rows, columns = torch.meshgrid(torch.arange(64), torch.arange(64), indexing="ij")
    truth = (((rows // 4 + columns // 4) % 2) * 0.6 + 0.2)[None, ..., None].expand(1, 64, 64, 3)
    planes = truth.permute(0, 3, 1, 2)
    blurred = torch.nn.functional.avg_pool2d(planes, 5, 1, 2, count_include_pad=False)
    brighter = (truth + 0.05).clamp(0, 1)
    assert lpips_vgg(blurred.permute(0, 2, 3, 1), truth) > 2 * lpips_vgg(brighter, truth)
