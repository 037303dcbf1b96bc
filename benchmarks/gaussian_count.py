"""Gaussian count: how good an avatar is with fewer or more of them, at full size.

    python -m benchmarks.gaussian_count --json FILE [--counts 10000 20000 30000 45000]
        [--schedule fine] [--folder FOLDER] [--at-once 2]

fits the synthetic studio at 512 pixels with `lean`, once for each number of Gaussians asked for,
and prints JSON: how many there are at the end (densification adds and drops some), processor
seconds of the fit (one thread), PSNR of novel views over the surface that the training camera saw,
and of the training camera's validation frames. `smallest_within_0.1_db` is the smallest number
asked for whose avatar is within 0.1 dB of the best over novel views. Beside FILE lies a chart,
`.svg` and `.png`.
"""

import argparse
import json
import multiprocessing
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure

from benchmarks.rasterizer import machine
from benchmarks.time_to_quality import PARAMS, filmed, fitted, psnr_seen, settings_of
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.config.reading import load_params
from deblur_avatar.evaluation.reblur import mean_reblur_psnr
from deblur_avatar.files import write_json
from deblur_avatar.reporting.charts import drawn, lay_out, panels
from deblur_avatar.run import chosen_device
from deblur_avatar.training.schedule import ScheduleParams

SIZE = 512
WITHIN_DB = 0.1
MEASURES = {
    "psnr_seen": "novel views, seen surface, dB",
    "psnr_validation": "validation frames, dB",
}


def row_of(count: int, schedule_name: str, folder: Path) -> dict[str, Any]:
    """Fit with so many Gaussians, and score."""
    torch.set_num_threads(1)
    schedule = load_params(PARAMS, f"schedules.{schedule_name}", ScheduleParams)
    observations, reference = filmed(SIZE, folder)
    asked = schedule.model_copy(update={"gaussians": count})
    last = fitted(observations, *settings_of("lean"), asked, frozenset())[-1]
    model = avatar_from_artifact(last.avatar, observations.body, chosen_device())
    return {
        "asked": count,
        "gaussians": len(last.avatar.means),
        "processor_seconds": round(last.processor_seconds, 1),
        "psnr_seen": round(psnr_seen(observations, reference, last), 4),
        "psnr_validation": round(_validation(model, observations, last.motion), 4),
    }


def _validation(model: Any, observations: Observations, motion: Any) -> float:
    score = mean_reblur_psnr(model, observations, motion, observations.validation)
    assert score is not None
    return score


def record_of(rows: Sequence[Mapping[str, Any]], schedule_name: str) -> dict[str, Any]:
    """The rows by number, and the smallest number that is as good as the best, within 0.1 dB."""
    rows = sorted(rows, key=lambda row: row["asked"])
    best = max(row["psnr_seen"] for row in rows)
    enough = min(row["asked"] for row in rows if row["psnr_seen"] >= best - WITHIN_DB)
    return {
        "machine": machine(0.0),
        "scene": "studio",
        "size": SIZE,
        "method": "lean",
        "schedule": schedule_name,
        "rows": [dict(row) for row in rows],
        "smallest_within_0.1_db": enough,
    }


def chart(record: Mapping[str, Any]) -> Figure:
    """PSNR over the number of Gaussians at the end, a panel a measure."""
    figure, axes = panels(1, len(MEASURES), named=False)
    for panel, (measure, label) in zip(axes[0], MEASURES.items(), strict=True):
        rows = record["rows"]
        counts = [row["gaussians"] for row in rows]
        panel.plot(counts, [row[measure] for row in rows], marker="o", color="#1f8a5b")
        for row in rows:
            panel.annotate(
                f"{row['processor_seconds']:.0f} s", (row["gaussians"], row[measure]),
                textcoords="offset points", xytext=(7, -11), ha="left", fontsize=8,
            )  # fmt: skip
        panel.set(title=label, xlabel="Gaussians at the end", ylabel="PSNR, dB")
        panel.margins(0.15)
    lay_out(figure)
    return figure


def main(arguments: argparse.Namespace) -> None:
    """Fit, print, write."""
    filmed(SIZE, arguments.folder)
    fit = partial(row_of, schedule_name=arguments.schedule, folder=arguments.folder)
    rows: list[dict[str, Any]] = []
    with multiprocessing.get_context("spawn").Pool(arguments.at_once) as pool:
        for row in pool.imap_unordered(fit, sorted(arguments.counts, reverse=True)):
            rows.append(row)
            print(json.dumps(row), flush=True)
            record = record_of(rows, arguments.schedule)
            if arguments.json:
                write_json(arguments.json, record)
                for name, data in drawn(arguments.json.stem, partial(chart, record)).items():
                    arguments.json.with_name(name).write_bytes(data)
    print(json.dumps(record, indent=1))


def _arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the record to this file")
    parser.add_argument("--counts", type=int, nargs="+", default=[10000, 20000, 30000, 45000])
    parser.add_argument("--schedule", default="fine", help="of params.yaml, at 512 pixels")
    parser.add_argument("--at-once", type=int, default=2, help="fits at a time")
    parser.add_argument(
        "--folder", type=Path, default=Path("data/time_to_quality"), help="where films are kept"
    )
    return parser.parse_args(words)


if __name__ == "__main__":
    main(_arguments())
