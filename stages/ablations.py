"""Stage `ablations`: the paper's tables, means and spreads over seeds."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.config.reading import load_params
from deblur_avatar.config.runs import RunParams
from deblur_avatar.pipeline.ablations import report_ablations


def main(seeds: Path, scene: str, out: Path, params_file: Path) -> None:
    """Write `<out>/index.html`, `tables.md` and `summary.json` from each seed's `metrics`."""
    schedule = load_params(params_file, "schedule", str)
    names = load_params(params_file, "seeds", tuple[str, ...])
    runs = load_params(params_file, "runs", dict[str, RunParams])
    with run.stage("ablations", scene, 0):
        folders = list(map(seeds.joinpath, names))
        report = report_ablations(folders, runs, scene, schedule)
        report.save(out)


if __name__ == "__main__":
    run.command(main)
