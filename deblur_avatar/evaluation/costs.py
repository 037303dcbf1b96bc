"""Training cost: seconds, memory and size of a run, gathered from what its stages measured.

Conventions. These measurements lie in files of their own, `<folder>/<stage>/<item>.json`, which no
stage but a report depends on: two runs of the same code take different times and are the same run.
A fitting stage leaves `seconds`, `peak_memory_mb` and, of each of its `snapshots`, `iteration` and
`seconds`; `evaluate` leaves `render_fps`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deblur_avatar.config.runs import RunParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.files import read_json

STAGES = ("warmup", "trajectory", "fusion")


def read_costs(files: Mapping[str, Path]) -> dict[str, float | None]:
    """Read what each stage of a run measured.

    Args:
        files: by stage, as `cost_files` names them; a warm-up may be shared with other methods and
            is counted in full.

    Returns:
        `train_s` and `<stage>_s`, wall-clock seconds, `peak_memory_mb` of the largest stage, and
        `render_fps`; None where a stage left no measurement.

    Raises:
        ArtifactError: if a measurement is damaged.
    """
    keys = ("seconds", "peak_memory_mb")
    found = {stage: _read(files[stage], keys) for stage in STAGES}
    seconds = {stage: content.get("seconds") for stage, content in found.items()}
    peaks = [content["peak_memory_mb"] for content in found.values() if content]
    rendering = _read(files["evaluate"], ("render_fps",))
    return {
        "train_s": _sum(list(seconds.values())),
        **{f"{stage}_s": value for stage, value in seconds.items()},
        "peak_memory_mb": max(peaks) if peaks else None,
        "render_fps": rendering.get("render_fps"),
    }


def with_seconds(curve: Mapping[str, Any], files: Mapping[str, Path]) -> dict[str, Any]:
    """A learning curve whose points say after how many seconds of training each avatar was kept.

    They count from the run's first iteration over its three stages, the warm-up in full although
    methods may share it; what writing snapshots took is not in them.

    Raises:
        ArtifactError: if a stage's measurement is missing or damaged, or not of this curve.
    """
    at: dict[tuple[str, int], float] = {}
    ends: dict[str, float] = {}  # of stages that kept nothing on the way
    before = 0.0
    for stage in STAGES:
        path = files[stage]
        content = read_json(path)
        try:
            for kept in content["snapshots"]:
                at[stage, int(kept["iteration"])] = before + _seconds(kept)
            before += _seconds(content)
            ends |= {} if content["snapshots"] else {stage: before}
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise ArtifactError(f"{path} is damaged: {error!r}; run `dvc repro`") from error
    points = []
    for point in curve["points"]:
        stage, iteration = point["stage"], point["iteration"]
        seconds = at.get((stage, iteration), ends.get(stage))
        if seconds is None:
            raise ArtifactError(
                f"{files[stage]} knows no snapshot of iteration {iteration}; it "
                "is of another run than the learning curve: run `dvc repro`"
            )
        points.append({"stage": stage, "iteration": iteration, "seconds": seconds} | point)
    return {**curve, "points": points}


def cost_files(folder: Path, run: RunParams) -> dict[str, Path]:
    """What each stage measured with a clock for a run, below `metrics/cost`."""
    items = dict.fromkeys((*STAGES, "evaluate"), f"{run.scene}-{run.method}")
    items["warmup"] = f"{run.scene}-{run.observations}-{run.avatar}"
    return {stage: folder / stage / f"{item}.json" for stage, item in items.items()}


def _seconds(measured: Mapping[str, Any]) -> float:
    value = measured["seconds"]
    if not isinstance(value, int | float):
        raise TypeError(f"seconds is a {type(value).__name__}")
    return float(value)


def _sum(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) if len(known) == len(values) else None


def _read(path: Path, keys: tuple[str, ...]) -> dict[str, Any]:
    if not path.exists():
        return {}
    content = read_json(path)
    found = {key: content.get(key) for key in keys}
    if not all(isinstance(value, int | float) for value in found.values()):
        raise ArtifactError(f"{path} is damaged: it says {found!r:.200}; run `dvc repro`")
    return found
