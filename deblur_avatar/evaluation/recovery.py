"""Recovery and the gap to the ceiling: a method's numbers beside those of the others on its scene.

Recovery is the share of what blur costs that a method wins back. Conventions. A *result* is the
content of one metrics file, `metrics/<scene>/<method>.json`: nested dictionaries of numbers, null
for what was not measured.
"""

import math
from collections.abc import Iterable, Mapping
from statistics import stdev
from typing import Any

from deblur_avatar.evaluation.metrics import HEADLINE, Metric, recovered_metrics

FLOOR, BOUND, CEILING = "agnostic", "oracle", "ceiling"

Result = dict[str, Any]


def share_won_back(value: float | None, floor: float | None, bound: float | None) -> float | None:
    """(value - floor) / (bound - floor): 0 is as good as the floor, 1 as good as the bound.

    None where something was not measured or the two are equal.
    """
    if value is None or floor is None or bound is None or bound == floor:
        return None
    return (value - floor) / (bound - floor)


def recovery(
    value: float | None, agnostic: float | None, oracle: float | None, row: Metric
) -> float | None:
    """Share of what blur costs that a method wins back, in one metric.

    Args:
        value: the method's.
        agnostic: of the avatar that ignores blur.
        oracle: of the avatar that saw sharp frames.
        row: the metric; its direction and the least cost of blur are in the table.

    Returns:
        0 for as good as agnostic, 1 for as good as the oracle; None where something was not
        measured or blur costs less than `row.min_blur_cost`.
    """
    if row.min_blur_cost is None or agnostic is None or oracle is None:
        return None
    if row.better * (oracle - agnostic) < row.min_blur_cost:
        return None
    return share_won_back(value, agnostic, oracle)


def nothing_recovered() -> dict[str, None]:
    """The entry `recovery` of a metrics file before methods are compared."""
    return dict.fromkeys(row.name for row in _in_file_order())


def _in_file_order() -> list[Metric]:
    """Decibels first, as metrics files have always had them: equal content is equal bytes."""
    return sorted(recovered_metrics(), key=lambda row: row.unit != "dB")


def compared(results: Mapping[str, Result]) -> dict[str, Result]:
    """Fill in recovery and the gap to the ceiling for every method of one scene.

    Without `agnostic`, `oracle` or `ceiling` among them what depends on it stays null.
    """

    def image(method: str, metric: str) -> float | None:
        found = (results.get(method, {}).get("image") or {}).get(metric)
        return float(found) if found is not None and math.isfinite(found) else None

    filled = {}
    for method, result in results.items():
        shares = {
            row.name: recovery(
                image(method, row.name), image(FLOOR, row.name), image(BOUND, row.name), row
            )
            for row in _in_file_order()
        }
        best, own = image(CEILING, HEADLINE), image(method, HEADLINE)
        gap = None if best is None or own is None else best - own
        filled[method] = {**result, "recovery": shares, "gap_to_ceiling_db": gap}
    return filled


def pooled(scenes: Mapping[str, Mapping[str, Result]], method: str) -> Result:
    """One method's results averaged over the scenes it was run on.

    Recovery is that of the averages, not the average of recoveries, which a scene with little blur
    would rule: agnostic and oracle are averaged over the same scenes.
    """
    own = {scene: results for scene, results in scenes.items() if method in results}
    means = {
        other: averaged([results[other] for results in own.values()])
        for other in dict.fromkeys((method, FLOOR, BOUND))
        if all(other in results for results in own.values())
    }
    gap = means[method].get("gap_to_ceiling_db")
    return compared(means)[method] | {"gap_to_ceiling_db": gap, "scenes": list(own)}


def averaged(results: Iterable[Result], *, complete: bool = False) -> Result:
    """Mean of each number over several results, over those where it was measured.

    Words, lists and truth values are kept where all agree on them and left out otherwise.

    Args:
        results: of several scenes, seeds or draws.
        complete: a number that one of them could not measure has no mean.
    """
    every = list(results)
    mean: Result = {}
    for key in dict.fromkeys(key for result in every for key in result):
        values = [result[key] for result in every if result.get(key) is not None]
        if values and all(isinstance(value, dict) for value in values):
            mean[key] = averaged(values, complete=complete)
        elif not values or (complete and len(values) < len(every)):
            mean[key] = None
        elif all(_is_number(value) for value in values):
            mean[key] = sum(values) / len(values)
        elif all(value == values[0] for value in values):
            mean[key] = values[0]
    return mean


def standard_deviations(results: Iterable[Result]) -> Result:
    """Standard deviation of each number over several scenes, where two or more measured it."""
    every = list(results)
    deviations: Result = {}
    for key in dict.fromkeys(key for result in every for key in result):
        values = [result[key] for result in every if result.get(key) is not None]
        if values and all(isinstance(value, dict) for value in values):
            deviations[key] = standard_deviations(values)
        elif len(values) > 1 and all(_is_number(value) for value in values):
            deviations[key] = stdev(values)
    return deviations


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
