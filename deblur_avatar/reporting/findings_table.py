"""Table of a check's findings."""

from collections.abc import Mapping
from typing import Any

from deblur_avatar.reporting.results_table import NOT_MEASURED, Cell, Column, Table


def findings_table(findings: Mapping[str, Mapping[str, Any]]) -> Table:
    """One row a finding: its number, its verdict, what to do."""
    return Table(
        columns=(Column((), ""), Column((), "verdict", kind="text"),
                 Column((), "what to do", kind="text")),
        rows=tuple((name.replace("_", " "), _cells(f)) for name, f in findings.items()),
        of="finding",
    )  # fmt: skip


def _cells(finding: Mapping[str, Any]) -> tuple[Cell, ...]:
    value, verdict = finding["value"], finding["verdict"]
    text = NOT_MEASURED if value is None else f"{value:.3g} {finding['unit']}"
    return Cell(text), Cell(verdict, kind=f"text {verdict}"), Cell(finding["advice"], kind="text")
