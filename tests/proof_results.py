"""A small proof's plan, and what its cells would have left, for tests of those who read it."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from deblur_avatar.config.proof import Cell, ProofParams, warmup_of
from deblur_avatar.config.reading import parse
from deblur_avatar.imaging.picture_files import write_picture

ITERATIONS = {"x1": 80, "x2": 160}
PLAN: dict[str, Any] = {
    "avatars": {"networks": "paper", "plain": "lean"},
    "columns": {
        "agnostic": {"observations": "blurred", "method": "agnostic"},
        "paper": {"observations": "blurred", "method": "paper"},
        "clip": {"observations": "blurred", "method": "lean"},
        "oracle": {"observations": "sharp", "method": "oracle"},
    },
    "scenes": {"studio": "tuning", "leaping": "report", "leaping_17": "report"},
    "filmed_at_root": ["studio"],
    "windows": {"leaping": {17: "leaping_17", 33: "leaping"}},
    "without_pictures": [],
    "parts": {
        "grid": {
            "scenes": ["leaping", "leaping_17"], "schedules": ["x1"], "seeds": 1,
            "cells": {"networks": ["agnostic", "paper", "oracle"],
                      "plain": ["agnostic", "clip", "oracle"]},
        },
        "seeds": {
            "scenes": ["leaping"], "schedules": ["x1"], "seeds": 2,
            "cells": {"plain": ["agnostic", "clip", "oracle"]},
        },
        "converged": {
            "scenes": ["studio"], "schedules": ["x1", "x2"], "seeds": 1,
            "cells": {"plain": ["agnostic", "clip"]},
        },
    },
    "run": ["grid", "seeds"],
}  # fmt: skip

COSTS: dict[str, Any] = {
    "machine": "an abacus", "schedule": "x1",
    "fits": {"networks": {"agnostic": 60.0, "paper": 120.0, "oracle": 60.0},
             "plain": {"agnostic": 30.0, "clip": 50.0, "oracle": 30.0}},
    "scene": 100.0, "scores": 10.0, "starts": 5.0,
}  # fmt: skip


def small_plan(**changes: Any) -> ProofParams:
    """`PLAN`, some sections of it others."""
    plan: ProofParams = parse(ProofParams, PLAN | changes, "proof")
    return plan


def write_cell(
    metrics: Path, cell: Cell, psnr: float, *, curve: bool = True, **image: float | None
) -> None:
    """Write a cell's results: `psnr` is that of the seen surface, all pixels have 8 dB more."""
    plan = small_plan()
    iterations = ITERATIONS[cell.schedule]
    content = {
        "scene": cell.scene, "method": plan.columns[cell.motion].method,
        "image": {"psnr": psnr + 8, "psnr_seen": psnr, "flip": 1 / psnr, **image},
        "motion": {"joint_error_mm": 10.0, "travel_error_mm": None},
        "model": {"gaussians": 300}, "run": {"iterations": iterations, "seed": cell.seed},
    }  # fmt: skip
    points = [
        {"stage": "fusion", "iteration": it, "image": {"psnr_seen": psnr - away}}
        for it, away in ((iterations // 4, 4.0), (iterations // 2, 0.5), (iterations, 0.0))
    ]
    kept = [{"iteration": p["iteration"], "seconds": p["iteration"] / 10} for p in points]
    spent = {"seconds": 0.0, "peak_memory_mb": 300.0, "snapshots": []}
    files = {
        f"evaluate/{cell.name}": content,
        f"cost/warmup/{warmup_of(cell, plan)}": spent,
        f"cost/trajectory/{cell.name}": spent,
        f"cost/fusion/{cell.name}": spent | {"seconds": iterations / 10, "snapshots": kept},
        f"cost/evaluate/{cell.name}": {"render_fps": 50.0},
    }
    if curve:
        files[f"learning_curve/{cell.name}"] = {"points": points}
    for name, written in files.items():
        path = metrics / cell.scene / f"{name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(written))


def write_pictures(data: Path, cell: Cell, level: int = 200) -> None:
    """Write what `evaluate` draws of a cell: one view of a person as bright as `level`."""
    folder = data / cell.scene / "evaluate" / cell.name
    picture = np.zeros((24, 24, 3), np.uint8)
    picture[6:18, 8:16] = level
    files = {name: f"{name}.png" for name in ("render", "blurred", "truth")}
    for file in files.values():
        write_picture(folder / file, picture)
    view = {"camera": "test1", "frame": 3, "novel_pose": False} | files
    (folder / "views.json").write_text(json.dumps([view]))
