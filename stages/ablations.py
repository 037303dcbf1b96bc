"""Stage `ablations`: the paper's tables, means and spreads over seeds."""

from pathlib import Path

from deblur_avatar import run
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.ablations import report_ablations


def main(seeds: Path, scene: str, out: Path, params_file: Path) -> None:
    """Write `<out>/index.html`, `tables.md` and `summary.json` from `<seeds>/seed_*/metrics`."""
    with run.stage("ablations", scene, 0):
        schedule = load_params(params_file, "schedule", str)
        report = report_ablations(seeds, scene, schedule)
        report.save(out)


if __name__ == "__main__":
    run.command(main)
