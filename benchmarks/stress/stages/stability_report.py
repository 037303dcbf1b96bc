"""Stage `stability_report`: rules applied to what the stability suite measured."""

import logging
from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from benchmarks.stress.params import ModeParams
from benchmarks.stress.report import report_stability
from deblur_avatar import run
from deblur_avatar.config.reading import load_params

logger = logging.getLogger(__name__)


def main(items: Path, scenes: Path, out: Path, metrics: Path, params_file: Path) -> None:
    """Write `<out>/index.html`, `<out>/stability.json` and `<metrics>/<mode>-<method>.json`."""
    modes = load_params(params_file, "modes", dict[str, ModeParams])
    with run.stage("stability_report", out.name, load_params(params_file, "seed", int)):
        report = report_stability(modes, items, scenes)
        report.save(out, metrics)
        logger.info("modes passed, of %d: %s", report.summary["modes"], report.summary["passed"])


if __name__ == "__main__":
    run.command(main)
