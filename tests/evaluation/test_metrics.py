"""The table of metrics: one row is all that scores, recovery, tables and charts need."""

import pytest
import torch

from deblur_avatar.evaluation import metrics
from deblur_avatar.evaluation.metrics import METRICS, ImagePair, Metric, metric, scores
from deblur_avatar.evaluation.recovery import compared, nothing_recovered
from deblur_avatar.imaging.metrics import flip, psnr
from deblur_avatar.pipeline.evaluate import evaluate
from deblur_avatar.reporting.report_tables import tables_of
from deblur_avatar.reporting.results_table import markdown

BRIGHTNESS = Metric(
    "brightness", lambda pair: (pair.render - pair.truth).abs().mean((1, 2, 3)), -1, "of 1", 1,
    "brightness error", "page", min_blur_cost=0.01,
)  # fmt: skip


@pytest.fixture
def pair():
    generator = torch.Generator().manual_seed(0)
    render, truth = torch.rand(2, 1, 24, 24, 3, generator=generator)
    half = torch.arange(24) < 12
    return ImagePair(render, truth, half.expand(1, 24, 24), half.expand(1, 24, 24).mT)


@pytest.fixture
def brightness(monkeypatch):
    """One more row, as somebody would add it."""
    monkeypatch.setattr(metrics, "METRICS", (*METRICS, BRIGHTNESS))
    return BRIGHTNESS


def test_a_row_scores_what_its_name_says(pair):
    assert scores(pair)["psnr"] == psnr(pair.render, pair.truth)
    assert scores(pair)["psnr_foreground"] == psnr(pair.render, pair.truth, pair.foreground)
    assert scores(pair)["psnr_seen"] == psnr(pair.render, pair.truth, pair.seen)
    assert scores(pair)["flip"] == flip(pair.render, pair.truth)
    assert scores(pair)["flip_seen"] == flip(pair.render, pair.truth, pair.seen)


@pytest.mark.parametrize("row", METRICS, ids=lambda row: row.name)
def test_equal_pictures_score_at_least_as_well_as_others_in_the_direction_of_a_row(row, pair):
    same = ImagePair(pair.truth, pair.truth, pair.foreground, pair.seen)
    other, best = row.function(pair), row.function(same)
    if row.name.startswith("sharpness"):
        assert best == 1
    elif not best.isnan().any():  # pictures of 24 pixels are too small for some
        assert (row.better * (best - other) > 0).all()


def test_names_are_told_apart_and_found():
    assert len({row.name for row in METRICS}) == len(METRICS)
    assert metric("flip").better == -1
    with pytest.raises(KeyError):
        metric("beauty")


def test_metrics_files_keep_the_order_of_their_keys():
    assert list(nothing_recovered()) == ["psnr", "psnr_seen", "ssim", "flip", "lpips_vgg"]
    assert [row.name for row in metrics.recovered_metrics()] == [
        "psnr", "ssim", "flip", "lpips_vgg", "psnr_seen",
    ]  # fmt: skip


def test_one_row_more_is_in_the_metrics_file(brightness, scene):
    measured = evaluate(
        scene.observations, scene.reference, scene.avatar, scene.motion, torch.device("cpu")
    ).metrics
    assert 0 < measured["image"]["brightness"] < 0.1
    assert measured["cameras"]["left"].keys() == measured["image"].keys()
    assert measured["recovery"]["brightness"] is None


def test_one_row_more_is_in_the_recovery(brightness):
    results = {"agnostic": 0.4, "oracle": 0.2, "paper": 0.35}
    filled = compared({name: {"image": {"brightness": v}} for name, v in results.items()})
    assert filled["paper"]["recovery"]["brightness"] == pytest.approx(0.25)


def test_one_row_more_is_in_the_tables(brightness):
    results = {
        name: {"image": {"psnr": 20.0, "brightness": value}}
        for name, value in {"agnostic": 0.44, "paper": 0.31}.items()
    }
    text = markdown(tables_of(results, {})[0])
    assert "brightness error (of 1) \u2193" in text
    assert "| **0.3** |" in text
