"""Fits of the proof's tuning scenes for a record: what it has stays, what it lacks is fitted."""

import argparse
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from benchmarks.rasterizer import machine
from benchmarks.time_to_quality import PARAMS
from deblur_avatar.config.reading import load_params
from deblur_avatar.files import write_json
from deblur_avatar.training.schedule import ScheduleParams

PROOF = Path("experiments/proof/params.yaml")
SIZE = 192  # pixels

Row = Mapping[str, Any]


def known_rows(path: Path | None, schedule_name: str) -> list[dict[str, Any]]:
    """What a record has already; nothing, if there is none.

    Raises:
        SystemExit: if it is of another schedule.
    """
    known = json.loads(path.read_text()) if path and path.exists() else {}
    if known.get("schedule", schedule_name) != schedule_name:
        raise SystemExit(
            f"{path} is of the schedule {known['schedule']}: give another file, --json"
        )
    return known.get("rows", [])


def complete_record(
    arguments: argparse.Namespace,
    keys: Sequence[str],
    wanted: Iterable[tuple[Any, ...]],
    fit: Callable[..., dict[str, Any]],
    summary_of: Callable[[Sequence[Row]], Any],
    **about: Any,
) -> None:
    """Fit what a record lacks; print each row, write the record after it, print the summary.

    Args:
        arguments: those of `parser_of`.
        keys: of a row, which tell rows apart.
        wanted: their values for each fit, in the order in which to fit.
        fit: takes those values, the folder of films and the schedule; returns a row.
        summary_of: what the rows say.
        about: what else stands in the record.
    """
    torch.set_num_threads(1)
    path: Path | None = arguments.json
    schedule = load_params(PARAMS, f"schedules.{arguments.schedule}", ScheduleParams)
    rows = known_rows(path, arguments.schedule)

    def key_of(row: Row) -> tuple[Any, ...]:
        return tuple(row[key] for key in keys)

    done = {key_of(row) for row in rows}
    for values in wanted:
        if values in done:
            continue
        rows.append(fit(*values, arguments.folder, schedule))
        print(json.dumps(rows[-1]), flush=True)
        if path:
            record = {
                "machine": machine(0.0), "schedule": arguments.schedule, **about,
                "summary": summary_of(rows), "rows": sorted(rows, key=key_of),
            }  # fmt: skip
            write_json(path, record)
    print(json.dumps(summary_of(rows), indent=1))


def parser_of(
    description: str, scenes: Sequence[str], seeds: Sequence[int], folder: str
) -> argparse.ArgumentParser:
    """Of what every such benchmark is asked: file, scenes, seeds, schedule, where films are."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--json", type=Path, help="write the record to this file, or go on with it")
    parser.add_argument("--scenes", nargs="+", choices=scenes, default=list(scenes))
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=list(seeds), help="of the fits' draws"
    )
    parser.add_argument("--schedule", default="medium", help="of params.yaml")
    parser.add_argument("--folder", type=Path, default=Path(folder), help="where films are kept")
    return parser
