"""Stage `proof`: the grid of avatars and motions, windows, seeds and convergence on one page."""

import logging
from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.config.proof import ProofParams
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.proof import report_proof

logger = logging.getLogger(__name__)


def main(metrics: Path, strips: Path, out: Path, params_file: Path) -> None:
    """Write `<out>/index.html`, `summary.json`, `tables.md` and the charts."""
    plan = load_params(params_file, "proof", ProofParams)
    with run.stage("proof", out.name, load_params(params_file, "seed", int)):
        report = report_proof(plan, metrics, strips)
        report.save(out)
        logger.info("%s", report.log)
        logger.info("The proof: %s", out / "index.html")


if __name__ == "__main__":
    run.command(main)
