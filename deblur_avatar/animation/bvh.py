"""Biovision hierarchy files (`.bvh`): a skeleton, and its joint angles over time.

Conventions. Angles are in degrees and multiply in the order in which a joint's channels are listed,
the first outermost; a position channel replaces that component of the joint's offset, as Blender
reads it, too. Axes and unit of length are the file's own: `animation/retargeting.py` finds the
former, is indifferent to the latter, and says which joints' positions it follows.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from deblur_avatar.animation.driving_motion import SkeletonMotion
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix

MAX_VALUE = 1e9  # of any number, in degrees or the file's unit of length
MAX_TURNS = 5_000_000  # frames times joints: 96 bytes each
SHORTEST_STEP = 1e-6  # seconds
_POSITIONS = {"Xposition": 0, "Yposition": 1, "Zposition": 2}
_ROTATIONS = {"Xrotation": 0, "Yrotation": 1, "Zrotation": 2}
_Lines = Iterator[tuple[int, list[str]]]


@dataclass
class _Joint:
    name: str
    parent: int
    offset: list[float] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)


def read_bvh(path: Path) -> SkeletonMotion:
    """Read one file; ends of bones become joints named `<joint>_end`.

    Raises:
        ArtifactError: naming the file, the line and what was expected there.
    """
    try:
        text = Path(path).read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise ArtifactError(f"cannot read {path}: {error}") from None
    rows = text.splitlines()
    lines = iter([(number, row.split()) for number, row in enumerate(rows, 1) if row.strip()])
    _expect(lines, path, ["HIERARCHY"])
    joints = _hierarchy(lines, path)
    _, words = _expect(lines, path, ["Frames:", 1])
    frames = _count(words[1], path)
    number, words = _expect(lines, path, ["Frame", "Time:", 1])
    step = _numbers(words[2:], 1, path, number)[0]
    if step < SHORTEST_STEP:
        raise ArtifactError(
            f"{path}:{number}: Frame Time must be positive, got {step:g} (at least "
            f"{SHORTEST_STEP:g} s)"
        )
    width = sum(len(joint.channels) for joint in joints)
    values = _motion(lines, path, frames, width)
    if len(values) * len(joints) > MAX_TURNS:
        raise ArtifactError(
            f"{path} has {len(values)} frames of {len(joints)} joints, at most {MAX_TURNS} turns "
            "of a joint are read; cut it, or leave joints out"
        )
    return _assemble(joints, values, 1 / step)


def _hierarchy(lines: _Lines, path: Path) -> list[_Joint]:
    """Read up to and including the word MOTION."""
    joints: list[_Joint] = []
    open_joints: list[int] = []
    for number, words in lines:
        where = f"{path}:{number}"
        match words:
            case ["MOTION"] if joints and not open_joints:
                return joints
            case ["ROOT", *name] if name and not joints:
                _open(joints, open_joints, " ".join(name), lines, path)
            case ["JOINT", *name] if name and open_joints:
                _open(joints, open_joints, " ".join(name), lines, path)
            case ["End", "Site"] if open_joints:
                name_of_end = joints[open_joints[-1]].name + "_end"
                _open(joints, open_joints, name_of_end, lines, path)
            case ["OFFSET", *values] if open_joints and not joints[open_joints[-1]].offset:
                joints[open_joints[-1]].offset = _numbers(values, 3, path, number)
            case ["CHANNELS", count, *names] if open_joints:
                _check_channels(names, count, where)
                joints[open_joints[-1]].channels = names
            case ["}"] if open_joints:
                closed = joints[open_joints.pop()]
                if not closed.offset:
                    raise ArtifactError(f"{where}: joint {closed.name} has no OFFSET")
            case _:
                raise ArtifactError(f"{where}: {' '.join(words)!r} does not belong here")
    raise ArtifactError(f"{path}: the file ends before MOTION")


def _open(
    joints: list[_Joint], open_joints: list[int], name: str, lines: _Lines, path: Path
) -> None:
    joints.append(_Joint(name, open_joints[-1] if open_joints else -1))
    open_joints.append(len(joints) - 1)
    _expect(lines, path, ["{"])


def _check_channels(names: list[str], count: str, where: str) -> None:
    known = {**_POSITIONS, **_ROTATIONS}
    if count != str(len(names)) or len(set(names)) != len(names) or not set(names) <= set(known):
        raise ArtifactError(
            f"{where}: CHANNELS must give a number and as many different names of "
            f"{', '.join(known)}; got {count} {' '.join(names)}"
        )


def _motion(lines: _Lines, path: Path, frames: int, width: int) -> NDArray[np.float64]:
    rows: list[list[float]] = []
    for number, words in lines:
        if len(rows) == frames:
            raise ArtifactError(f"{path}:{number}: Frames says {frames}, but {words[0]} follows")
        rows.append(_numbers(words, width, path, number))
    if len(rows) < frames:
        raise ArtifactError(f"{path}: Frames says {frames}, the file ends after {len(rows)}")
    return np.array(rows)


def _assemble(joints: list[_Joint], values: NDArray[np.float64], fps: float) -> SkeletonMotion:
    table = torch.from_numpy(values)
    rotations = torch.eye(3, dtype=torch.float64).repeat(len(table), len(joints), 1, 1)
    offsets = torch.tensor([joint.offset for joint in joints], dtype=torch.float64)
    positions = {0: offsets[0].repeat(len(table), 1)}
    column = 0
    for index, joint in enumerate(joints):
        for channel in joint.channels:
            if channel in _ROTATIONS:
                axis_angle = torch.zeros(len(table), 3, dtype=torch.float64)
                axis_angle[:, _ROTATIONS[channel]] = torch.deg2rad(table[:, column])
                rotations[:, index] = rotations[:, index] @ axis_angle_to_matrix(axis_angle)
            else:
                if index not in positions:
                    positions[index] = offsets[index].repeat(len(table), 1)
                positions[index][:, _POSITIONS[channel]] = table[:, column]
            column += 1
    return SkeletonMotion(
        fps=fps,
        names=tuple(joint.name for joint in joints),
        parents=tuple(joint.parent for joint in joints),
        offsets=offsets,
        rotations=rotations,
        positions=positions,
    )


def _expect(lines: _Lines, path: Path, pattern: list[str | int]) -> tuple[int, list[str]]:
    """Take the next line; words must match, a number stands for that many values."""
    wanted = " ".join(word if isinstance(word, str) else "<number>" for word in pattern)
    number, words = next(lines, (0, []))
    if not words:
        raise ArtifactError(f"{path}: the file ends where {wanted!r} should stand")
    fits = len(words) == len(pattern) and all(
        isinstance(word, int) or word == found for word, found in zip(pattern, words, strict=True)
    )
    if not fits:
        raise ArtifactError(f"{path}:{number}: wanted {wanted!r}, got {' '.join(words)[:60]!r}")
    return number, words


def _count(word: str, path: Path) -> int:
    if not re.fullmatch("[0-9]{1,18}", word) or int(word) < 1:
        raise ArtifactError(f"{path}: Frames must be a positive number, got {word!r:.30}")
    return int(word)


def _numbers(words: list[str], count: int, path: Path, number: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise ArtifactError(f"{path}:{number}: {error}") from None
    if len(values) != count or not all(abs(value) <= MAX_VALUE for value in values):
        raise ArtifactError(
            f"{path}:{number}: wanted {count} finite numbers (at most {MAX_VALUE:g}), "
            f"got {' '.join(words)[:60]!r} ({len(words)} of them)"
        )
    return values
