"""What fitting a run cost, gathered from the measurements of its three stages."""

from pathlib import Path
from typing import Any

from deblur_avatar.config.runs import RunParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.run import read_json

STAGES = ("warmup", "trajectory", "fusion")


def cost_files(folder: Path, run: RunParams) -> dict[str, Path]:
    """What each fitting stage of a run measured, in their order; the warm-up may be shared."""
    paths = {stage: folder / stage / f"{run.scene}-{run.method}.json" for stage in STAGES}
    paths["warmup"] = folder / "warmup" / f"{run.scene}-{run.observations}-{run.start}.json"
    return paths


def read_costs(folder: Path, run: RunParams) -> dict[str, float | None]:
    """Read `<folder>/<stage>/<item>.json` of each fitting stage.

    Args:
        folder: where all metrics are.
        run: whose costs; its warm-up may be shared with other methods and is counted in full.

    Returns:
        `train_s` and `<stage>_s`, wall-clock seconds, and `peak_memory_mb` of the largest stage;
        None where a stage left no measurement.

    Raises:
        ArtifactError: if a measurement is damaged.
    """
    found = {stage: _read(path) for stage, path in cost_files(folder, run).items()}
    seconds = {stage: content.get("seconds") for stage, content in found.items()}
    peaks = [content["peak_memory_mb"] for content in found.values() if content]
    return {
        "train_s": _sum(list(seconds.values())),
        **{f"{stage}_s": value for stage, value in seconds.items()},
        "peak_memory_mb": max(peaks) if peaks else None,
    }


def _sum(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) if len(known) == len(values) else None


def _read(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    content = read_json(path)
    found = {key: content.get(key) for key in ("seconds", "peak_memory_mb")}
    if not all(isinstance(value, int | float) for value in found.values()):
        raise ArtifactError(f"{path} is damaged: it says {found!r:.200}; run `dvc repro`")
    return found
