"""Early stopping: each cell where its own curve is best, and where validation frames stop it.

What a longer or shorter run would have made of a comparison. Its own best is chosen by the views
that are scored, which nobody could have done: a bound of what any rule of stopping could bring.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from deblur_avatar.evaluation.metrics import metric
from deblur_avatar.evaluation.proof_grid import Found
from deblur_avatar.evaluation.recovery import recovery
from deblur_avatar.reporting.proof_tables import MAIN, RECOVERY_DIGITS, UNFITTED
from deblur_avatar.reporting.results_table import Cell, Column, Table, look_up, shown

Point = Mapping[str, Any]
Choice = Callable[[Sequence[Point]], Point | None]


def stopping_table(found: Sequence[Found], scene: str) -> Table:
    """The end, the best point and the point validation frames choose, of each cell's curve.

    Args:
        found: cells of one scene, schedule and seed; those without a curve are left out.
        scene: its name, for the title.
    """
    row = metric(MAIN)
    quality = Column((), row.title, row.unit, row.decimals)
    length = Column((), "iteration", digits=0)
    share = Column((), "recovery", digits=RECOVERY_DIGITS)
    curves: dict[str, dict[str, list[Point]]] = {}
    for one in found:
        if points := [p for p in (one.curve or {}).get("points") or () if _quality(p) is not None]:
            curves.setdefault(one.cell.avatar, {}).setdefault(one.cell.motion, points)
    rows = []
    for avatar, motions in curves.items():
        texts: dict[str, list[str]] = {motion: [] for motion in motions}
        for choose in CHOICES.values():
            chosen = {motion: choose(curve) for motion, curve in motions.items()}
            floor, bound = (_quality(chosen.get(motion)) for motion in ("agnostic", "oracle"))
            for motion, point in chosen.items():
                value = _quality(point)
                texts[motion] += [
                    shown(value, quality, UNFITTED),
                    shown(look_up(point or {}, ("iteration",)), length, UNFITTED),
                    shown(recovery(value, floor, bound, row), share, UNFITTED),
                ]
        rows += [(f"{avatar}, {m}", tuple(map(Cell, of))) for m, of in texts.items()]
    heads = [
        column
        for name in CHOICES
        for column in (replace(quality, label=f"{row.title} {name}"), length, share)
    ]
    return Table(tuple(heads), tuple(rows), title=f"{scene}: stopped elsewhere", note=NOTE)


def _quality(point: Point | None) -> float | None:
    return look_up(point or {}, ("image", MAIN))


def _best(points: Sequence[Point]) -> Point:
    return max(points, key=lambda p: p["image"][MAIN])


def _by_validation(points: Sequence[Point]) -> Point | None:
    known = {v: p for p in points if (v := look_up(p, ("validation_psnr",))) is not None}
    return known[max(known)] if known else None


CHOICES: dict[str, Choice] = {
    "at the end": lambda points: points[-1],
    "at its best": _best,
    "by validation frames": _by_validation,
}
NOTE = (
    "On the few test views of the curves. At its best is chosen by these very views, for every "
    "cell, agnostic and oracle too: no rule of stopping could do better. Validation frames are "
    "blurred ones of the camera that was fitted to. No recovery where blur costs too little."
)
