"""The results tables of README.md and docs/results.md are made of what the pipelines left.

Those of the proof come from its metrics (`proof_headline`), the others from what `report` wrote.

python -m tests.structure.readme_table --write
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tests.structure.pipeline_files import ROOT
from tests.structure.proof_headline import READ, tables_of_proof

BEGIN, END = "<!-- results: copied by `make readme` -->", "<!-- end of results -->"
PROOF_BEGIN, PROOF_END = "<!-- proof: copied by `make readme` -->", "<!-- end of proof -->"


def first_section(text: str) -> str:
    """A text up to its second heading."""
    head, *rest = text.split("\n### ")
    return head if head.startswith("### ") or not rest else f"{head}\n### {rest[0]}"


def whole_report(root: Path) -> str:
    """The table that `report` wrote in a checkout.

    Raises:
        FileNotFoundError: if it has not.
    """
    return (root / REPORT).read_text()


class Block(NamedTuple):
    """Part of a document that is made of results."""

    document: Path
    begin: str
    end: str
    read: tuple[str, ...]  # of the checkout
    made: Callable[[Path], str]  # of a checkout


REPORT = "reports/table.md"
README, RESULTS = ROOT / "README.md", ROOT / "docs" / "results.md"
BLOCKS = (
    Block(README, PROOF_BEGIN, PROOF_END, READ, lambda root: first_section(tables_of_proof(root))),
    Block(RESULTS, PROOF_BEGIN, PROOF_END, READ, tables_of_proof),
    Block(RESULTS, BEGIN, END, (REPORT,), whole_report),
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


def copied(block: Block, root: Path) -> str:
    """A block's document as it is with the results of a checkout.

    Raises:
        FileNotFoundError: if they are not there.
    """
    document = block.document.read_text()
    return with_table(document, block.made(root), block.begin, block.end)


def main() -> int:
    """Copy the tables, or with no option say whether they are up to date (exit code 1 if not)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="change the documents")
    write = parser.parse_args().write
    old = False
    for block in BLOCKS:
        made = copied(block, ROOT)
        changed = made != block.document.read_text()
        old |= changed
        if write:
            block.document.write_text(made)
        state = "up to date" if not changed else "changed" if write else "old"
        sys.stdout.write(f"{block.document.name}, of {block.read[-1]}: {state}\n")
    return int(old and not write)


if __name__ == "__main__":
    raise SystemExit(main())
