"""The results tables of README.md and docs/results.md are those that `report` and `proof` wrote.

python -m tests.structure.readme_table --write
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tests.structure.pipeline_files import ROOT

BEGIN, END = "<!-- results: copied by `make readme` -->", "<!-- end of results -->"
PROOF_BEGIN, PROOF_END = "<!-- proof: copied by `make readme` -->", "<!-- end of proof -->"


def first_section(text: str) -> str:
    """A text up to its second heading."""
    head, *rest = text.split("\n### ")
    return head if head.startswith("### ") or not rest else f"{head}\n### {rest[0]}"


class Block(NamedTuple):
    """Part of a document that is copied from a report."""

    document: Path
    report: Path
    begin: str
    end: str
    part: Callable[[str], str] = str


HEADLINE = ROOT / "reports" / "proof" / "headline.md"
RESULTS = ROOT / "docs" / "results.md"
BLOCKS = (
    Block(ROOT / "README.md", HEADLINE, PROOF_BEGIN, PROOF_END, first_section),
    Block(RESULTS, HEADLINE, PROOF_BEGIN, PROOF_END),
    Block(RESULTS, ROOT / "reports" / "table.md", BEGIN, END),
)


def with_table(document: str, table: str, begin: str = BEGIN, end: str = END) -> str:
    """The document with the table between its two marks.

    Raises:
        ValueError: if the marks are not there, once each and in order.
    """
    if (
        document.count(begin) != 1
        or document.count(end) != 1
        or document.index(begin) > document.index(end)
    ):
        raise ValueError(f"the document must hold {begin!r} and then {end!r}, once each")
    before, rest = document.split(begin)
    return f"{before}{begin}\n\n{table.strip()}\n\n{end}{rest.split(end)[1]}"


def copied(block: Block, report: str) -> str:
    """A block's document as it is with such a report."""
    document = block.document.read_text()
    return with_table(document, block.part(report), block.begin, block.end)


def main() -> int:
    """Copy the tables, or with no option say whether they are up to date (exit code 1 if not)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="change the documents")
    write = parser.parse_args().write
    old = False
    for block in BLOCKS:
        made = copied(block, block.report.read_text())
        changed = made != block.document.read_text()
        old |= changed
        if write:
            block.document.write_text(made)
        state = "up to date" if not changed else "changed" if write else "old"
        sys.stdout.write(f"{block.document.name}, of {block.report.name}: {state}\n")
    return int(old and not write)


if __name__ == "__main__":
    raise SystemExit(main())
