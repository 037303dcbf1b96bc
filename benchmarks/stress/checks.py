"""Checks: what the rules of the stress suite are made of.

A check is one number and the limits that it must keep. It is made of one severity of a mode, as one
method went through it, beside what `agnostic` made of it and what the ceiling reaches. Scores, dB.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.stress.params import SeverityParams
from deblur_avatar.evaluation.recovery import share_won_back

Row = Mapping[str, Any]

AGNOSTIC = "agnostic"
# dB between two fits that differ in nothing that matters (the `seeds` mode: 0.05 to 0.2)
SCATTER = 0.1


@dataclass(frozen=True)
class Check:
    """One number and between which limits it must lie; without limits it is only told."""

    what: str
    value: float | None
    minimum: float | None = None
    maximum: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the number is within its limits; one that was not measured is not."""
        if self.minimum is None and self.maximum is None:
            return True
        if self.value is None or not math.isfinite(self.value):
            return False
        low, high = self.minimum, self.maximum
        return (low is None or self.value >= low) and (high is None or self.value <= high)

    @property
    def sentence(self) -> str:
        """The number and the limit that it keeps or breaks."""
        value = "not measured" if self.value is None else f"{self.value:.2f}"
        limits = [f"at least {self.minimum:.2f}"] if self.minimum is not None else []
        limits += [f"at most {self.maximum:.2f}"] if self.maximum is not None else []
        return f"{self.what} is {value}" + (f", wanted {' and '.join(limits)}" if limits else "")


@dataclass(frozen=True)
class Case:
    """One severity of one mode, as one method went through it."""

    method: str
    severity: SeverityParams
    row: Row
    agnostic: Row
    ceiling: Row
    clean: Row  # the method on the clean scene
    before: tuple[Row, ...]  # the milder severities

    @property
    def score(self) -> float | None:
        """PSNR over the seen surface, dB; None where no avatar came out."""
        return self.row.get("score")


def minus(value: float | None, other: float | None) -> float | None:
    """The difference; None where one was not measured."""
    return None if value is None or other is None else value - other


def ratio(value: int | float | None, other: int | float | None) -> float | None:
    """The quotient; None where one was not measured or the second is nought."""
    return None if value is None or not other else value / other


def came_out(case: Case) -> Check:
    """An avatar with finite numbers came out."""
    reason = f" ({case.row['refused']})" if case.row.get("refused") else ""
    return Check(f"avatars that came out{reason}", float(bool(case.row.get("finite"))), minimum=1.0)


def refused(case: Case) -> Check:
    """The pipeline said no, with an error of its own."""
    return Check("refused with a message", float(bool(case.row.get("refused"))), minimum=1.0)


def above_agnostic(
    case: Case, margin: float, key: str = "score", name: str = "score", drop: float = 3.0
) -> Check:
    """Not worse than without a model of blur by `margin`; for `agnostic` its own clean `drop`."""
    if case.method == AGNOSTIC:
        change = minus(case.row.get(key), case.clean.get(key))
        return Check(f"{name} minus the clean scene's", change, minimum=-drop)
    gain = minus(case.row.get(key), case.agnostic.get(key))
    return Check(f"{name} minus agnostic's", gain, minimum=margin)


def drop_from_clean(case: Case, maximum: float) -> Check:
    """At most so many decibels below the clean scene."""
    lost = minus(case.clean.get("score"), case.score)
    return Check("dB lost against the clean scene", lost, maximum=maximum)


def recovery(
    case: Case, bound: Row | None = None, key: str = "score", name: str = "recovery"
) -> Check:
    """Which share of what blur costs is won back, against a bound: the ceiling, or another."""
    bound = case.ceiling if bound is None else bound
    share = share_won_back(case.row.get(key), case.agnostic.get(key), bound.get(key))
    return Check(name, share)


def amount(case: Case) -> float:
    """How much of its one damage the severity does."""
    return next(iter(case.severity.damage.values()), 0.0)
