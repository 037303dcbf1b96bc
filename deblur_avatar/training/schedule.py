"""Training schedule: when each stage ends, how large avatar and pictures are."""

from typing import Annotated

from pydantic import Field, model_validator

from deblur_avatar.config.section import Count, Fraction, Params, Share
from deblur_avatar.errors import ConfigError

PAPER_ITERATIONS = 15_000  # arXiv 2501.13335, sec. IV-A


class LevelParams(Params):
    """One level of coarse-to-fine fitting: how much smaller everything is, and until when."""

    until: Fraction  # of the iterations
    size: Share  # of the pictures' sides
    gaussians: Share  # of their final number
    virtual_poses: Count  # at most

    @property
    def whole(self) -> bool:
        """Whether pictures are compared at their full size."""
        return self.size == 1


# What follows the levels that a schedule names.
FULL = LevelParams(until=1.0, size=1.0, gaussians=1.0, virtual_poses=1_000_000)


class ScheduleParams(Params):
    """How much work a run is: when each stage ends, how large avatar and pictures are.

    Fitting climbs `levels`, in which pictures and avatar grow, to the full size.
    """

    warmup: Count  # iterations
    trajectory: Count
    fusion: Count
    gaussians: Count
    image_height: Annotated[int, Field(ge=8)]  # pixels
    levels: tuple[LevelParams, ...]  # before the full size

    @property
    def scale(self) -> float:
        """Iterations of this schedule for one of the paper's."""
        return self.fusion / PAPER_ITERATIONS

    def level_at(self, iteration: int) -> LevelParams:
        """The level that an iteration belongs to."""
        return next((one for one in self.levels if iteration <= self._end(one)), FULL)

    def grows_at(self, iteration: int) -> bool:
        """Whether an iteration is the first of a level that follows another."""
        return any(iteration == self._end(level) + 1 for level in self.levels)

    def gaussians_of(self, level: LevelParams) -> int:
        """How many Gaussians a level begins with, at least."""
        return max(1, round(self.gaussians * level.gaussians))

    def _end(self, level: LevelParams) -> int:
        return round(level.until * self.fusion)

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
        for name in ("until", "size", "gaussians"):
            values = [getattr(level, name) for level in (*self.levels, FULL)]
            if values != sorted(values):
                raise ValueError(f"levels: {name} must not fall from one level to the next")
        return self
