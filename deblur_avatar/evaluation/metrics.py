"""Image metrics as a table: what scores a render, which way is better, how it is shown.

A metric is one row of `METRICS`. Everything that speaks of metrics reads it there: the scores of
`evaluate` and of the learning curve, recovery, the tables and charts of the reports. To add one,
write its function (`imaging/metrics.py`) and its row.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.imaging import metrics
from deblur_avatar.imaging.lpips import lpips_vgg

HEADLINE = "psnr"  # the metric of charts, of the gap to the ceiling, and that decides for a table


@dataclass(frozen=True, eq=False)
class ImagePair:
    """Renders of B test views beside their ground truth."""

    render: Float[Tensor, "B H W 3"]  # sRGB
    truth: Float[Tensor, "B H W 3"]  # sRGB
    foreground: Bool[Tensor, "B H W"]  # of the truth
    seen: Bool[Tensor, "B H W"]  # surface that the training camera saw at some time

    @cached_property
    def flip_map(self) -> Float[Tensor, "B H W"]:
        """FLIP at each pixel: computed once, since two metrics and a picture need it."""
        return metrics.flip_map(self.render, self.truth)


@dataclass(frozen=True)
class Metric:
    """One row of the table.

    Attributes:
        name: key in metrics files.
        function: one score for each of the B pictures; NaN where it cannot be measured.
        better: 1 if larger is, -1 if smaller is.
        unit: as a table shows it, or what the metric is of.
        decimals: in a table.
        title: of its column.
        tables: of which reports: none, the page's tables of views, or the short table too.
        min_blur_cost: how much better than `agnostic` the `oracle` must be for a share of the
            difference to mean anything: seeds differ by as much. None for a metric of which no
            recovery is given, and which no learning curve follows.
    """

    name: str
    function: Callable[[ImagePair], Float[Tensor, " B"]]
    better: Literal[1, -1]
    unit: str
    decimals: int
    title: str
    tables: Literal["none", "page", "short"]
    min_blur_cost: float | None = None


METRICS: tuple[Metric, ...] = (
    Metric(
        "psnr", lambda v: metrics.psnr(v.render, v.truth), 1, "dB", 2, "PSNR", "short",
        min_blur_cost=0.5,
    ),
    Metric(
        "ssim", lambda v: metrics.ssim(v.render, v.truth), 1, "", 3, "SSIM", "short",
        min_blur_cost=0.001,
    ),
    Metric(
        "ssim_range2", lambda v: metrics.ssim_range2(v.render, v.truth), 1, "", 4,
        "SSIM (range 2)", "none",
    ),
    Metric("ms_ssim", lambda v: metrics.ms_ssim(v.render, v.truth), 1, "", 3, "MS-SSIM", "none"),
    Metric(
        "flip", lambda v: v.flip_map.double().mean((1, 2)), -1, "", 3, "FLIP", "short",
        min_blur_cost=0.001,
    ),
    Metric(
        "lpips_vgg", lambda v: lpips_vgg(v.render, v.truth), -1, "VGG", 3, "LPIPS", "page",
        min_blur_cost=0.001,
    ),
    Metric(
        "psnr_foreground", lambda v: metrics.psnr(v.render, v.truth, v.foreground), 1, "dB", 2,
        "PSNR person", "page",
    ),
    Metric(
        "psnr_seen", lambda v: metrics.psnr(v.render, v.truth, v.seen), 1, "dB", 2, "PSNR seen",
        "short", min_blur_cost=0.5,
    ),
    Metric(
        "ssim_seen", lambda v: metrics.ssim(v.render, v.truth, v.seen), 1, "", 3, "SSIM seen",
        "none",
    ),
    Metric(
        "flip_seen", lambda v: metrics.masked_mean(v.flip_map.double(), v.seen), -1, "", 3,
        "FLIP seen", "page",
    ),
    Metric(
        "sharpness_ratio", lambda v: metrics.sharpness_ratio(v.render, v.truth, v.foreground), 1,
        "of the truth", 2, "sharpness", "none",
    ),
    Metric(
        "sharpness_ratio_seen", lambda v: metrics.sharpness_ratio(v.render, v.truth, v.seen), 1,
        "of the truth", 2, "sharpness seen", "none",
    ),
)  # fmt: skip


def metric(name: str) -> Metric:
    """The row of that name.

    Raises:
        KeyError: if there is none.
    """
    return {row.name: row for row in METRICS}[name]


def recovered_metrics() -> list[Metric]:
    """The metrics that recovery is given for and learning curves follow."""
    return [row for row in METRICS if row.min_blur_cost is not None]


def shown_metrics(*tables: str) -> list[str]:
    """Names of the metrics that stand in these tables, in their order."""
    return [row.name for row in METRICS if row.tables in tables]


def scores(pair: ImagePair) -> dict[str, Float[Tensor, " B"]]:
    """Every metric of some pictures, by name."""
    return {row.name: row.function(pair) for row in METRICS}
