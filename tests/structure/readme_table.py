"""The results tables of README.md are those that `report` and `proof` wrote.

python -m tests.structure.readme_table --write
"""

import argparse
import sys

from tests.structure.pipeline_files import ROOT

README, TABLE = ROOT / "README.md", ROOT / "reports" / "table.md"
BEGIN, END = "<!-- results: copied by `make readme` -->", "<!-- end of results -->"
HEADLINE = ROOT / "reports" / "proof" / "headline.md"
PROOF_BEGIN, PROOF_END = "<!-- proof: copied by `make readme` -->", "<!-- end of proof -->"
BLOCKS = ((TABLE, BEGIN, END), (HEADLINE, PROOF_BEGIN, PROOF_END))


def with_table(readme: str, table: str, begin: str = BEGIN, end: str = END) -> str:
    """The README with the table between its two marks.

    Raises:
        ValueError: if the marks are not there, once each and in order.
    """
    if (
        readme.count(begin) != 1
        or readme.count(end) != 1
        or readme.index(begin) > readme.index(end)
    ):
        raise ValueError(f"README.md must hold {begin!r} and then {end!r}, once each")
    before, rest = readme.split(begin)
    return f"{before}{begin}\n\n{table.strip()}\n\n{end}{rest.split(end)[1]}"


def main() -> int:
    """Copy the tables, or with no option say whether they are up to date (exit code 1 if not)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="change README.md")
    write = parser.parse_args().write
    old = new = README.read_text()
    for table, begin, end in BLOCKS:
        new = with_table(new, table.read_text(), begin, end)
    if write:
        README.write_text(new)
    sys.stdout.write(
        f"README.md: {'up to date' if old == new else 'changed' if write else 'old'}\n"
    )
    return int(old != new and not write)


if __name__ == "__main__":
    raise SystemExit(main())
