"""Stage `report`: all results on one page, in one summary, in one table."""

import logging
from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.config.reading import load_params
from deblur_avatar.config.runs import RunParams
from deblur_avatar.pipeline.report import make_report

logger = logging.getLogger(__name__)


def main(
    metrics: Path, pictures: Path, animations: Path, exports: Path, out: Path, params_file: Path
) -> None:
    """Write `<out>/index.html`, avatars' pages, `summary.json`, `table.md`, charts and a strip."""
    runs = load_params(params_file, "runs", dict[str, RunParams])
    animated = load_params(params_file, "animations", dict)
    exported = load_params(params_file, "exports", dict)
    hidden = load_params(params_file, "without_pictures", list[str])
    with run.stage("report", out.name, load_params(params_file, "seed", int)):
        report = make_report(
            runs, animated, metrics, pictures, animations, hidden,
            exports=exports, exported=exported,
        )  # fmt: skip
        report.save(out)
        logger.info("%s", report.log)
        logger.info("The report: %s", out / "index.html")


if __name__ == "__main__":
    run.command(main)
