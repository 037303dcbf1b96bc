"""What the stages of a run would have measured with a clock, for tests of those who read it."""

import json
from collections.abc import Mapping
from pathlib import Path

from deblur_avatar.config.runs import RunParams


def run_of(scene: str, method: str) -> RunParams:
    """A run of its own warm-up."""
    return RunParams(scene=scene, observations="blurred", avatar=method, method=method)


def write_costs(
    metrics: Path, run: RunParams, seconds: float, snapshots: Mapping[int, float] | None = None
) -> None:
    """Write a run's costs, all of them its fusion's; `snapshots` are seconds by iteration."""
    item = f"{run.scene}-{run.method}"
    kept = [{"iteration": i, "seconds": s} for i, s in (snapshots or {}).items()]
    spent = {"seconds": 0.0, "peak_memory_mb": 300.0, "snapshots": []}
    contents = {
        f"warmup/{run.scene}-{run.observations}-{run.avatar}": spent,
        f"trajectory/{item}": spent,
        f"fusion/{item}": spent | {"seconds": seconds, "snapshots": kept},
        f"evaluate/{item}": {"render_fps": 50.0},
    }
    for name, content in contents.items():
        path = metrics / "cost" / f"{name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content))
