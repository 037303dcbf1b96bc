"""The table of all limits in docs/stability.md: `python -m tests.stress.limits_table` writes it.

It is the second place where every number stands, so that none can be changed by accident.
"""

from benchmarks.stress.checks import Limit
from benchmarks.stress.rules import ALL, RULES
from tests.structure.pipeline_files import ROOT

PAGE = ROOT / "docs/stability.md"
BEGIN, END = "<!-- limits: begin -->\n", "<!-- limits: end -->\n"


def limits_table() -> str:
    """Every limit of the rules, those of one quantity and alike in one row."""
    modes: dict[tuple[str, str, str], list[str]] = {}
    for mode, rows in RULES.items():
        for row in rows:
            if isinstance(row, Limit) and (row.minimum, row.maximum) != (None, None):
                key = (_name(row), _number(row.minimum), _number(row.maximum))
                modes.setdefault(key, []).append("every mode" if mode == ALL else f"`{mode}`")
    lines = ["| quantity | at least | at most | in |", "|---|---:|---:|---|"]
    lines += [
        f"| {what} | {least} | {most} | {', '.join(where)} |"
        for (what, least, most), where in modes.items()
    ]
    return "\n".join(lines) + "\n"


def _name(limit: Limit) -> str:
    what = limit.quantity.what.rstrip(",")
    return what if limit.level is None else f"{what}, {limit.level} severities"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:g}"


def with_table(page: str, table: str) -> str:
    """The page with a table between its marks.

    Raises:
        ValueError: if it has no marks for one.
    """
    return page[: page.index(BEGIN) + len(BEGIN)] + table + page[page.index(END) :]


def main() -> None:
    """Write the table."""
    PAGE.write_text(with_table(PAGE.read_text(), limits_table()))


if __name__ == "__main__":
    main()
