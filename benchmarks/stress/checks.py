"""Checks: what the rules of the stress suite are made of.

A rule is rows of two kinds. A `Limit` holds one quantity between two numbers; a `Fact` must be so.
Both say where they apply, so that a rule is a table and every number in it can be changed by a
test. They judge a `Case`: one severity of a mode, as one method went through it, beside what
`agnostic` made of it and what the ceiling reaches. Scores are PSNR over the seen surface, dB.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from benchmarks.stress.params import SeverityParams

Row = Mapping[str, Any]

AGNOSTIC = "agnostic"


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
    """One severity of one mode, as one method went through it.

    Attributes:
        method: its name.
        severity: what was done to the scene and to the fit.
        row: what was measured.
        agnostic: the same of `agnostic`, with the same avatar, and in `oracle` of its recipe on
            the sharp frames.
        ceiling: of sharp frames and exact poses on this scene, with the same avatar.
        clean: the method on the clean scene.
        clean_ceiling: the ceiling of the clean scene.
        before: what came before it in the mode, with the same avatar.
    """

    method: str
    severity: SeverityParams
    row: Row
    agnostic: Row
    ceiling: Row
    clean: Row
    clean_ceiling: Row
    before: tuple[Row, ...]

    @property
    def score(self) -> float | None:
        """PSNR over the seen surface, dB; None where no avatar came out."""
        return self.row.get("score")

    @property
    def amount(self) -> float:
        """How much of its first damage the severity does; 0 where it does none."""
        return next(iter(self.severity.damage.values()), 0.0)


Where = Callable[[Case], bool]


def everywhere(case: Case) -> bool:
    """At every severity, for every method."""
    return True


@dataclass(frozen=True)
class Quantity:
    """A number that limits are about; None where it was not measured."""

    what: str
    of: Callable[[Case], float | None]


@dataclass(frozen=True)
class Limit:
    """Between which numbers a quantity must lie; without any it is only told.

    `level` restricts it to the severities of that level, `where` further.
    """

    quantity: Quantity
    minimum: float | None = None
    maximum: float | None = None
    level: Literal["mild", "severe"] | None = None
    where: Where = field(default=everywhere)

    def applies(self, case: Case) -> bool:
        """Whether this is asked of a case."""
        return self.level in (None, case.severity.level) and self.where(case)

    def check(self, case: Case) -> Check:
        """The quantity of this case beside the limits."""
        return Check(self.quantity.what, self.quantity.of(case), self.minimum, self.maximum)


@dataclass(frozen=True)
class Fact:
    """What must be so: there is no number to it."""

    what: str
    holds: Callable[[Case], bool]
    where: Where = field(default=everywhere)

    def applies(self, case: Case) -> bool:
        """Whether this is asked of a case."""
        return self.where(case)

    def check(self, case: Case) -> Check:
        """1 where it is so, 0 where not; with why, where the pipeline refused."""
        holds, why = self.holds(case), case.row.get("refused")
        reason = f" ({why})" if why and not holds else ""
        return Check(self.what + reason, float(holds), minimum=1.0)


Rule = tuple[Limit | Fact, ...]


def minus(value: float | None, other: float | None) -> float | None:
    """The difference; None where one was not measured."""
    return None if value is None or other is None else value - other


def ratio(value: int | float | None, other: int | float | None) -> float | None:
    """The quotient; None where one was not measured or the second is nought."""
    return None if value is None or not other else value / other
