"""A sweep of 24 small fits, run in four ways that must end in the same bytes:

- `dvc repro`, one stage after the other;
- `deblur-avatar sweep` with one task at a time, and with two;
- a Ray cluster of two machines (raylets of this one), one of which goes away half way.

    python -m tests.sweep --json FILE

Prints JSON: seconds of each way, the speed-up, what a fit takes beside another against alone, and
every file that differs; ends with 1 if one does. `tests/sweep/test_*.py` are its small versions.
"""

import argparse
import json
import logging
import os
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from deblur_avatar.pipeline.code import refresh
from deblur_avatar.sweep.costs import Costs
from deblur_avatar.sweep.local_engine import this_machine
from deblur_avatar.sweep.scheduler import Ended, Engine, Progress, Watch, work_off
from deblur_avatar.sweep.stages import Pipelines
from tests.equivalence.footage import write_footage
from tests.structure.small_repository import called
from tests.sweep.small_sweep import ROOT

FOLDER = Path("experiments/grid")
FITS = f"{FOLDER}/dvc.yaml:fusion"
CASES = "experiments/cases/params.yaml"
SCENES = ("studio", "linear", "unfitted")
METHODS = ("agnostic", "paper", "no_fusion", "cubic", "mad", "mad_literal", "network", "lean")
SIZE = {
    "warmup": 100, "trajectory": 250, "fusion": 500, "gaussians": 2000, "image_height": 96,
    "levels": [],
}  # fmt: skip
# What a clock says, and locks, which hold its hash.
CLOCKS = ("metrics/cost", "dvc.lock")

logger = logging.getLogger(__name__)


def begin(root: Path, names: Sequence[str]) -> None:
    """A clone of what is committed, with the grid of some scenes, and all that its fits see."""
    called(root.parent, "git", "clone", "-q", str(ROOT), str(root))
    cases = yaml.safe_load((ROOT / CASES).read_text())
    footage = root / "footage"
    write_footage(footage)
    scenes = {name: cases["scenes"][name] for name in names}
    for scene in scenes.values():
        scene["clip"]["image_size"] = SIZE["image_height"]
    body = {**cases["bodies"]["capsules"], "file": "../../footage/SMPL_NEUTRAL.npz"}
    params = cases | {
        "schedule": "grid",
        "schedules": {"grid": SIZE},
        "snapshots": 0,
        "bodies": {"capsules": body},
        "scenes": scenes,
        "checks": [],
        "predeblur": {},
        "warmups": {f"{scene}-blurred-lean": fit(scene) for scene in names},
        "runs": {
            f"{scene}-{method}": fit(scene) | {"method": method}
            for scene in names
            for method in METHODS
        },
        "learning_curves": {}, "self_checks": {}, "exports": {}, "animations": {}, "reports": [],
    }  # fmt: skip
    (root / FOLDER).mkdir()
    (root / FOLDER / "params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))
    shutil.copy(root / "dvc.yaml", root / FOLDER / "dvc.yaml")
    refresh(root)
    called(root, "dvc", "repro", "-q", f"{FOLDER}/dvc.yaml:preprocess", code=root)


def fit(scene: str) -> dict[str, str]:
    """What a fit sees, and what it fits."""
    return {"scene": scene, "observations": "blurred", "avatar": "lean"}


def serially(root: Path) -> Progress | None:
    """By DVC alone."""
    called(root, "dvc", "repro", "-q", FITS, code=root)
    return None


def swept(root: Path, start: Callable[[Path], Engine], watch: Watch | None = None) -> Progress:
    """By an engine; nothing may fail."""
    os.chdir(root)
    pipelines = Pipelines(Path(), [FITS])
    pipelines.run_always_changed()
    before, tasks = pipelines.locks(), pipelines.tasks(Costs(Path()))
    progress = work_off(tasks, start(root), watch or told)
    pipelines.put_in_order(before)
    assert not progress.failed, progress.failed
    return progress


def told(progress: Progress, ended: Ended | None) -> None:
    """A line for each end."""
    if ended:
        count = f"{len(progress.done)} of {len(progress.tasks)}"
        logger.info("%s: %s %s (%s)", count, ended.name, ended.end, ended.where)


def on_a_cluster(root: Path) -> Progress:
    """Two raylets; one is gone once half of the tasks are done, while both are at work."""
    from ray.cluster_utils import Cluster

    from deblur_avatar.sweep.ray_engine import RayEngine

    machine = {"num_cpus": 1, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=machine)
    others = [cluster.add_node(**machine)]

    def watch(progress: Progress, ended: Ended | None) -> None:
        told(progress, ended)
        at_work = ended is None and len(progress.running) == 2
        if others and at_work and 2 * len(progress.done) >= len(progress.tasks):
            cluster.remove_node(others.pop(), allow_graceful=False)

    try:
        return swept(root, lambda folder: RayEngine(folder, cluster.address, os.environ), watch)
    finally:
        cluster.shutdown()


WAYS: dict[str, Callable[[Path], Progress | None]] = {
    "dvc_repro": serially,
    "one_at_a_time": lambda root: swept(root, lambda folder: this_machine(folder, 1)),
    "two_at_a_time": lambda root: swept(root, lambda folder: this_machine(folder, 2)),
    "cluster": on_a_cluster,
}


def written(root: Path) -> dict[str, bytes]:
    """All that stages of the grid wrote, but what a clock says."""
    paths = [path for path in (root / FOLDER).rglob("*") if path.is_file()]
    named = {path.relative_to(root / FOLDER).as_posix(): path for path in paths}
    return {name: path.read_bytes() for name, path in named.items() if not name.startswith(CLOCKS)}


def fit_seconds(root: Path) -> float:
    """What all fits say that they took, together."""
    files = (root / FOLDER / "metrics/cost").rglob("*.json")
    return float(sum(json.loads(path.read_text())["seconds"] for path in files))


def ways(folder: Path, asked: Sequence[str], scenes: Sequence[str]) -> dict[str, Any]:
    """Run the grid in every way, each in a copy of its own with a cache of its own."""
    begin(folder / "begun", scenes)
    found: dict[str, Any] = {}
    for name in asked:
        root = Path(shutil.copytree(folder / "begun", folder / name, symlinks=True))
        os.environ["PYTHONPATH"] = str(root)
        began = time.perf_counter()
        progress = WAYS[name](root)
        found[name] = {
            "seconds": round(time.perf_counter() - began, 1),
            "fit_seconds": round(fit_seconds(root), 1),
            "begun_again": sum(progress.lost.values()) if progress else 0,
            "fits": len(list((root / FOLDER / "data/fusion").iterdir())),
        }
        logger.info("%s: %s", name, found[name])
    return found


def differing(folder: Path, asked: Sequence[str]) -> dict[str, list[str]]:
    """Files of each way that are not those of the first."""
    first, *others = (written(folder / name) for name in asked)
    return {
        name: sorted(path for path in first.keys() | other.keys() if not same(first, other, path))
        for name, other in zip(asked[1:], others, strict=True)
    }


def same(one: Mapping[str, bytes], other: Mapping[str, bytes], path: str) -> bool:
    """Whether both have a file, of the same bytes."""
    return path in one and one.get(path) == other.get(path)


def main() -> int:
    """Run, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write there, too")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES, help="8 fits each")
    asked = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    with tempfile.TemporaryDirectory() as folder:
        found = ways(Path(folder), asked.ways, asked.scenes)
        differences = differing(Path(folder), asked.ways)
        files = len(written(Path(folder) / asked.ways[0]))
        os.chdir(ROOT)
    report: dict[str, Any] = {
        "machine": f"{os.cpu_count()} cores, {platform.processor() or platform.machine()}",
        "ways": found,
        "files_compared": files,
        "differing": differences,
    }
    if {"one_at_a_time", "two_at_a_time"} <= found.keys():
        one, two = found["one_at_a_time"], found["two_at_a_time"]
        report["speedup"] = round(one["seconds"] / two["seconds"], 3)
        report["fit_beside_another"] = round(two["fit_seconds"] / one["fit_seconds"], 3)
    text = f"{json.dumps(report, indent=1)}\n"
    sys.stdout.write(text)
    if asked.json:
        asked.json.write_text(text)
    return 1 if any(differences.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
