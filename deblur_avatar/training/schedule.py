"""Training schedule: when each stage ends, how large avatar and pictures are."""

from typing import Annotated

from pydantic import Field, model_validator

from deblur_avatar.config.section import (
    Count,
    Params,
)
from deblur_avatar.errors import ConfigError

PAPER_ITERATIONS = 15_000  # arXiv 2501.13335, sec. IV-A


class ScheduleParams(Params):
    """How much work a run is: when each stage ends, how large avatar and pictures are."""

    warmup: Count  # iterations
    trajectory: Count
    fusion: Count
    gaussians: Count
    image_height: Annotated[int, Field(ge=8)]  # pixels

    @property
    def scale(self) -> float:
        """Iterations of this schedule for one of the paper's."""
        return self.fusion / PAPER_ITERATIONS

    def halvings(self, count: int) -> frozenset[int]:
        """Iterations at 1/2, 1/4, 1/8 ... of a run, and at its stages' ends; none for a count of 0.

        Raises:
            ConfigError: if the count is negative.
        """
        if count < 0:
            raise ConfigError(f"snapshots: wanted 0 or more, got {count}")
        halves = (round(self.fusion / 2**power) for power in range(1, count + 1))
        ends = (self.warmup, self.trajectory, self.fusion) if count else ()
        return frozenset(halves) | frozenset(ends)

    @model_validator(mode="after")
    def _in_order(self) -> "ScheduleParams":
        if not self.warmup < self.trajectory < self.fusion:
            raise ValueError("warmup < trajectory < fusion must hold")
        return self
