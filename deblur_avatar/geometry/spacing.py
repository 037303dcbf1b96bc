"""Evenly spaced choice among many: frames, views."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

T = TypeVar("T")


def evenly_spaced(choices: Sequence[T], max_count: int) -> list[T]:
    """At most `max_count` of some things in their order, the first and the last among them."""
    steps = np.linspace(0, len(choices) - 1, min(max_count, len(choices))).round().astype(int)
    return [choices[step] for step in steps]
