"""Garments: where each begins and ends, and how loose it hangs.

Conventions. The rest pose of `Body`: T-pose, +Y up, facing +Z, the left hand towards +X, metres. A
garment covers the part of the body where its field is positive; fields are distances from the hems,
roughly in metres. Looseness goes from 0, tight, to 1 at the loosest hem. N places.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES

HEAD = SMPL_JOINT_NAMES.index("head")
Places = Float[np.ndarray, "N 3"]
Values = Float[np.ndarray, " N"]


@dataclass(frozen=True)
class Landmarks:
    """Measures of a resting body; the left side stands for both."""

    joints: Float[np.ndarray, "J 3"]
    head_size: float  # from the head's joint to the crown

    def of(self, name: str) -> Float[np.ndarray, " 3"]:
        """Where a joint rests."""
        return self.joints[SMPL_JOINT_NAMES.index(name)]

    def in_head(self, places: Places) -> Places:
        """Places relative to the head's joint, in units of the head's size."""
        return (places - self.of("head")) / self.head_size

    def from_collar(self, places: Places) -> Values:
        """Distance from the middle of the neck, a little longer than it is wide."""
        return np.linalg.norm((places - self.of("neck") - (0, 0.035, 0)) * (1, 0.9, 1), axis=1)


@dataclass(frozen=True)
class Garment:
    """A shell over the body; its distance goes from `tight` to `loose` with its looseness."""

    piece: str
    on_head: bool  # whether it grows on the head or on the rest of the body
    field: Callable[[Places, Landmarks], Values]
    looseness: Callable[[Places, Landmarks], Values]
    tight: float  # metres from the body
    loose: float
    least: float  # metres from the body below which it never sinks
    smoothing: int  # rounds
    refined: bool  # whether it needs finer triangles than the body has, for its folds

    def covers(
        self, places: Places, lbs_weights: Float[np.ndarray, "N J"], marks: Landmarks
    ) -> Values:
        """The field, kept from chins that would wear shirts and hands that would grow hair."""
        allowed = (lbs_weights[:, HEAD] > 0.5) == self.on_head
        return np.where(allowed, self.field(places, marks), -1.0)


def find_landmarks(
    vertices: Float[np.ndarray, "V 3"],
    joints: Float[np.ndarray, "J 3"],
    lbs_weights: Float[np.ndarray, "V J"],
) -> Landmarks:
    """Measure a resting body."""
    head: Bool[np.ndarray, " V"] = lbs_weights.argmax(1) == HEAD
    return Landmarks(joints, float(vertices[head, 1].max() - joints[HEAD, 1]))


def rise(values: Values, low: float, high: float) -> Values:
    """From 0 at `low` to 1 at `high` without a corner; `low` may be above `high`."""
    share = np.clip((values - low) / (high - low), 0, 1)
    return share * share * (3 - 2 * share)


def _shirt(places: Places, marks: Landmarks) -> Values:
    sleeve = 0.35 * marks.of("left_shoulder")[0] + 0.65 * marks.of("left_elbow")[0]
    sides = sleeve - np.abs(places[:, 0])
    top = marks.of("neck")[1] + 0.055 - places[:, 1]
    hem = places[:, 1] - (marks.of("pelvis")[1] - 0.045)
    collar = marks.from_collar(places) - 0.1
    return np.min([sides, top, hem, collar], axis=0)


def _shirt_looseness(places: Places, marks: Landmarks) -> Values:
    hem = rise(places[:, 1], marks.of("spine2")[1], marks.of("pelvis")[1] - 0.05)
    shoulder, elbow = marks.of("left_shoulder")[0], marks.of("left_elbow")[0]
    return np.maximum(hem, rise(np.abs(places[:, 0]), shoulder, elbow - 0.06))


def _shorts(places: Places, marks: Landmarks) -> Values:
    waist = marks.of("pelvis")[1] + 0.05 - places[:, 1]
    return np.minimum(waist, places[:, 1] - (marks.of("left_knee")[1] + 0.05))


def _shorts_looseness(places: Places, marks: Landmarks) -> Values:
    return rise(places[:, 1], marks.of("left_hip")[1], marks.of("left_knee")[1] + 0.05)


def _socks(places: Places, marks: Landmarks) -> Values:
    ankle = marks.of("left_ankle")[1]
    return np.minimum(ankle + 0.16 - places[:, 1], places[:, 1] - (ankle - 0.05))


def _tight(places: Places, marks: Landmarks) -> Values:
    return np.zeros(len(places))


def _hair(places: Places, marks: Landmarks) -> Values:
    x, y, z = marks.in_head(places).T
    line = 0.02 + 0.38 * rise(z, -0.25, 0.12) + 0.32 * rise(z, 0.1, 0.48) + 0.02 * np.cos(9 * x)
    return np.minimum(y - line, 0.485 - np.abs(x)) * marks.head_size


def _hair_looseness(places: Places, marks: Landmarks) -> Values:
    return rise(_hair(places, marks), 0.0, 0.05)


GARMENTS = (
    Garment("shirt", False, _shirt, _shirt_looseness, 0.015, 0.028, 0.012, 40, True),
    Garment("shorts", False, _shorts, _shorts_looseness, 0.007, 0.024, 0.006, 30, True),
    Garment("socks", False, _socks, _tight, 0.004, 0.004, 0.004, 2, True),
    Garment("hair", True, _hair, _hair_looseness, 0.006, 0.026, 0.006, 6, False),
)
