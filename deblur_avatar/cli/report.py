"""Write the report over the results there are: reports/index.html and reports/table.md."""

import argparse
import logging
from pathlib import Path

from deblur_avatar.cli.running_dvc import check_checkout, reproduce

logger = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """None."""


def run(asked: argparse.Namespace) -> int:
    """Run the stage `report` alone, print its table; returns DVC's exit code."""
    check_checkout(Path())
    code = reproduce(["--single-item", "report"])
    return code or show_report()


def show_report() -> int:
    """Print the report's table and where the page lies."""
    logger.info("%s", Path("reports/table.md").read_text())
    logger.info("The report: reports/index.html")
    return 0
