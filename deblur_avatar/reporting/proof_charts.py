"""The proof's chart: quality of every cell over seconds of training.

Conventions. A curve is of (seconds, quality) at each snapshot. The Pareto front is over the
snapshots of all cells of a scene that saw blurred frames.
"""

import math
from collections.abc import Mapping, Sequence

from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deblur_avatar.config.proof import MOTIONS
from deblur_avatar.reporting.charts import COLORS, INK, lay_out, legend, panels
from deblur_avatar.reporting.proof_tables import SETTLED, SHARP, settled_s
from deblur_avatar.reporting.speed_accuracy import pareto_front

CROWDED = 2.2  # decades from where on three labels each touch
Curve = Sequence[tuple[float, float]]
Curves = Mapping[str, Mapping[str, Curve]]  # by avatar and motion


def quality_chart(scenes: Mapping[str, Curves], quality: str) -> Figure:
    """A row a scene, a column an avatar; no panel where a scene has no curve of it.

    Dashed: cells that saw sharp frames. Ringed: where a cell reaches `SETTLED` of its final
    quality. Dotted: the Pareto front of both avatars' cells.

    Args:
        scenes: curves by scene.
        quality: what the curves are of, with its unit.
    """
    avatars = list(dict.fromkeys(avatar for curves in scenes.values() for avatar in curves))
    motions = {m for curves in scenes.values() for every in curves.values() for m in every}
    colors = {motion: COLORS[motion] for motion in MOTIONS if motion in motions}
    figure, axes = panels(len(scenes), len(avatars), named=True)
    for line, (scene, curves) in zip(axes, scenes.items(), strict=True):
        front = front_of(curves)
        for panel, avatar in zip(line, avatars, strict=True):
            if avatar not in curves:
                panel.set_visible(False)
                continue
            panel.step(*zip(*front, strict=True), where="post", color=INK, lw=1.0,
                       ls=(0, (1, 2))) if front else None  # fmt: skip
            for motion, curve in curves[avatar].items():
                _draw(panel, curve, colors[motion], sharp=motion in SHARP)
            panel.set(title=f"{scene}, {avatar}", xlabel="training, seconds", ylabel=quality,
                      xscale="log")  # fmt: skip
            panel.xaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
            panel.xaxis.set_minor_locator(ticker.NullLocator())
        _align([panel for panel in line if panel.get_visible()])
    legend(figure, colors)
    lay_out(figure)
    return figure


def _align(line: Sequence[Axes]) -> None:
    """Give panels side by side the widest of their axes, and as many labels as have room."""
    lows, highs = zip(*(panel.get_ylim() for panel in line), strict=True)
    starts, ends = zip(*(panel.get_xlim() for panel in line), strict=True)
    start, end = min(starts), max(ends)
    steps = (1, 2, 5) if math.log10(end / start) < CROWDED else (1, 3)
    for panel in line:
        panel.set(ylim=(min(lows), max(highs)), xlim=(start, end))
        panel.xaxis.set_major_locator(ticker.LogLocator(subs=steps))


def front_of(curves: Curves) -> list[tuple[float, float]]:
    """The best that any cell that saw blur has reached, over time."""
    points = {
        f"{avatar}-{motion}-{index}": point
        for avatar, every in curves.items()
        for motion, curve in every.items()
        if motion not in SHARP
        for index, point in enumerate(curve)
    }
    return [points[name] for name in pareto_front(points)]


def _draw(panel: Axes, curve: Curve, color: str, *, sharp: bool) -> None:
    panel.plot(
        *zip(*curve, strict=True), color=color, marker="o", ms=3.5, lw=1.6,
        ls=(0, (4, 2.5)) if sharp else "-",
    )  # fmt: skip
    seconds = settled_s(curve)
    if seconds is not None:
        panel.plot(seconds, SETTLED * curve[-1][1], "o", ms=10, mfc="none", mec=color, mew=1.4)
