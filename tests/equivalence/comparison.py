"""Two versions' artifacts, byte by byte.

Metrics are compared value by value, where both versions have a value under one name: between
versions they are split into files, and what a clock says never agrees.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import torch
from safetensors.torch import load

from deblur_avatar.sweep.costs import stage_of
from tests.equivalence.cases import Job
from tests.equivalence.names import Renaming

# What a clock or the machine's memory says: files, and keys of older metrics.
COST_FOLDER = "cost"
COST_KEYS = frozenset(
    {
        "cost", "seconds", "peak_memory_mb", "training_s", "train_s", "warmup_s", "trajectory_s",
        "fusion_s", "render_fps", "processor_s",
    }
)  # fmt: skip


@dataclass
class Comparison:
    """What two versions made of their small cases."""

    compared: set[str] = field(default_factory=set)  # jobs of both, by today's names
    differences: list[tuple[str, str]] = field(default_factory=list)  # a job; stage and file
    one_sided: list[str] = field(default_factory=list)  # stages and values of one version alone
    renamed: set[str] = field(default_factory=set)  # stages whose artifacts hold renamed words


@dataclass(frozen=True)
class Side:
    """One version's jobs and the tree that they wrote to."""

    tree: Path
    jobs: list[Job]


def compare(then: Side, now: Side, renaming: Renaming) -> Comparison:
    """Compare all that both versions' jobs have written."""
    found = Comparison()
    before = {renaming.text(job.name) for job in then.jobs}
    after = {job.name for job in now.jobs}
    found.compared = before & after
    found.one_sided += sorted(f"{stage_of(name)}: only before" for name in before - after)
    found.one_sided += sorted(f"{stage_of(name)}: only now" for name in after - before)
    old_files = {renaming.text(path): (file, job) for path, file, job in _files(then)}
    new_files = {path: (file, job) for path, file, job in _files(now)}
    for path in sorted(old_files.keys() | new_files.keys()):
        old, new = old_files.get(path), new_files.get(path)
        if old and new:
            _compare_file(path, old[0], new[0], new[1], renaming, found)
        else:
            file, job = old or new  # type: ignore[misc]
            _one_sided(path, renaming.text(job), before=bool(old), found=found)
    for job in after - before:  # split off: all that it writes, another stage wrote before
        written = [path for path, (_, name) in new_files.items() if name == job]
        if written and old_files.keys() >= set(written):
            found.compared.add(job)
    return found


def _files(side: Side) -> Iterator[tuple[str, Path, str]]:
    for job in side.jobs:
        for out in job.outs:
            path = side.tree / out
            files = sorted(path.rglob("*")) if path.is_dir() else [path]
            for file in files:
                if file.is_file():
                    yield file.relative_to(side.tree).as_posix(), file, job.name


def is_metrics(path: str) -> bool:
    """Whether a file holds measurements: JSON outside of `data`."""
    parts = PurePosixPath(path).parts
    return path.endswith(".json") and "data" not in parts


def _one_sided(path: str, job: str, *, before: bool, found: Comparison) -> None:
    """A file of a stage that both versions ran must be in both, unless metrics were split."""
    when = "only before" if before else "only now"
    if is_metrics(path):
        found.one_sided.append(f"{stage_of(job)}: a file of metrics: {when}")
    elif job in found.compared:
        found.differences.append((job, f"{stage_of(job)}: {path} is there {when}"))


def _compare_file(
    path: str, old: Path, new: Path, job: str, renaming: Renaming, found: Comparison
) -> None:
    if COST_FOLDER in PurePosixPath(path).parts:
        return
    if is_metrics(path):
        values = compared_values(_json(old), _json(new), renaming)
        found.differences += [
            (job, f"{stage_of(job)}: {path}: {text}") for text in values.differences
        ]
        found.one_sided += [f"{stage_of(job)}: {text}" for text in values.one_sided]
    elif old.read_bytes() != new.read_bytes():
        same, words = _same_json(old, new, renaming) if path.endswith(".json") else (False, False)
        if same and words:
            found.renamed.add(stage_of(job))
        elif not same:
            line = f"{stage_of(job)}: {path} differs{_where(old, new)}"
            found.differences.append((job, line))


def _same_json(old: Path, new: Path, renaming: Renaming) -> tuple[bool, bool]:
    """Whether two files say the same, and whether by other words; whatever their clocks say."""
    before, after = list(leaves(_json(old))), list(leaves(_json(new)))
    by_todays_words = list(leaves(renaming.content(_json(old))))
    return by_todays_words == after, before != after


@dataclass(frozen=True)
class Values:
    """Two versions' values under the same names."""

    common: int
    differences: list[str]
    one_sided: list[str]


def compared_values(old: Any, new: Any, renaming: Renaming) -> Values:
    """Compare values that two versions measured; not those that a clock says."""
    before, after = dict(leaves(renaming.content(old))), dict(leaves(new))
    both = [key for key in after if key in before]
    return Values(
        common=len(both),
        differences=[
            f"{_dotted(key)} was {before[key]!r}, is {after[key]!r}"
            for key in both
            if before[key] != after[key]
        ],
        one_sided=sorted(
            {f"{_unnumbered(key)}: only before" for key in before if key not in after}
            | {f"{_unnumbered(key)}: only now" for key in after if key not in before}
        ),
    )


def leaves(
    content: Any, above: tuple[str, ...] = (), *, costs: bool = False
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every value within, with the keys that lead to it; what a clock says only if asked for."""
    if isinstance(content, dict | list) and content:
        entries = content.items() if isinstance(content, dict) else enumerate(content)
        for key, value in entries:
            if costs or key not in COST_KEYS:
                yield from leaves(value, (*above, str(key)), costs=costs)
    else:
        yield above, content


def _dotted(key: tuple[str, ...]) -> str:
    return ".".join(key)


def _unnumbered(key: tuple[str, ...]) -> str:
    return _dotted(tuple(part for part in key if not part.isdigit()))


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


def _where(old: Path, new: Path) -> str:
    """The first tensor that differs and by how much, if these are tensors."""
    if old.suffix != ".safetensors":
        return ""
    before, after = load(old.read_bytes()), load(new.read_bytes())
    for name in sorted(before.keys() | after.keys()):
        if name not in before or name not in after:
            return f" in {name}, which is only {'before' if name in before else 'now'}"
        if before[name].shape != after[name].shape:
            return f" in the shape of {name}"
        if not torch.equal(before[name], after[name]):
            gap = (before[name].double() - after[name].double()).abs().max()
            return f" in {name}, by {gap:.3g} at most"
    return " in their order or precision"
