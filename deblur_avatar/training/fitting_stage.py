"""The bookends of the three fitting stages: what they are given, and what they leave."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from deblur_avatar import run
from deblur_avatar.config.reading import load_params
from deblur_avatar.files import write_json
from deblur_avatar.rendering.rasterize import BACKEND_VARIABLE
from deblur_avatar.training.resume import RunFolder, run_folder, run_key
from deblur_avatar.training.schedule import ScheduleParams
from deblur_avatar.training.trainer import Report


@dataclass(frozen=True)
class FittingStage:
    """Where and how one stage of fitting runs."""

    schedule: ScheduleParams
    device: torch.device
    generator: torch.Generator
    report: Report
    folder: RunFolder
    out: Path

    def finish(self, metrics: Path, cost: Path, measured: Mapping[str, Any]) -> None:
        """Write what was measured, once all else is written, and clear the working folder.

        What a clock or the memory says goes to `cost`, a file of its own: nothing that decides
        whether a later stage is up to date may hold it.
        """
        facts = {name: value for name, value in measured.items() if name != "seconds"}
        spent = {"seconds": measured["seconds"], "peak_memory_mb": run.peak_memory_mb()}
        write_json(metrics, facts)
        write_json(cost, {**spent, "snapshots": self.folder.finish(self.out)})


@contextmanager
def fitting_stage(
    name: str, out: Path, params_file: Path, settings: Sequence[Any], inputs: Sequence[Path]
) -> Iterator[FittingStage]:
    """Begin the stage `name` that writes to `out`, or go on where an earlier process was stopped.

    Args:
        name: warmup, trajectory or fusion.
        out: a folder, named after the item.
        params_file: read for seed, schedule and number of snapshots.
        settings: the stage's own parameters; with the `inputs` they tell runs apart.
        inputs: folders that it reads.
    """
    chosen = load_params(params_file, "schedule", str)
    schedule = load_params(params_file, f"schedules.{chosen}", ScheduleParams)
    kept = schedule.halvings(load_params(params_file, "snapshots", int))
    with run.stage(name, out.name, load_params(params_file, "seed", int)) as context:
        facts = [context.seed, context.device, sorted(kept), os.environ.get(BACKEND_VARIABLE)]
        key = run_key(facts, [schedule, *settings], inputs)
        report = run.fitting_progress(f"{name} {out.name}", getattr(schedule, name))
        with run_folder(out, key, kept) as folder:
            yield FittingStage(schedule, context.device, context.generator, report, folder, out)
