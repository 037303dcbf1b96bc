"""Stage `proof_strips`: pictures of the cells that were fitted here, kept beside the page."""

import logging
from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.config.proof import ProofParams
from deblur_avatar.config.reading import load_params
from deblur_avatar.evaluation.proof_grid import read_cells
from deblur_avatar.pipeline.proof_strips import gather_strips

logger = logging.getLogger(__name__)


def main(metrics: Path, pictures: Path, out: Path, params_file: Path) -> None:
    """Write `<out>/<scene>/<avatar>`; what was kept there before and nothing replaces stays."""
    plan = load_params(params_file, "proof", ProofParams)
    with run.stage("proof_strips", out.name, load_params(params_file, "seed", int)):
        new = gather_strips(plan, read_cells(plan, metrics), pictures, out)
        logger.info("Pictures kept: %s", "; ".join(new) or "none that were not there")


if __name__ == "__main__":
    run.command(main)
