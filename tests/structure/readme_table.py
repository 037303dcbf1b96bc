"""The results table of README.md is the one that `report` wrote.

python -m tests.structure.readme_table --write
"""

import argparse
import sys

from tests.structure.pipeline_files import ROOT

README, TABLE = ROOT / "README.md", ROOT / "reports" / "table.md"
BEGIN, END = "<!-- results: copied by `make readme` -->", "<!-- end of results -->"


def with_table(readme: str, table: str) -> str:
    """The README with the table between its two marks.

    Raises:
        ValueError: if the marks are not there, once each and in order.
    """
    if (
        readme.count(BEGIN) != 1
        or readme.count(END) != 1
        or readme.index(BEGIN) > readme.index(END)
    ):
        raise ValueError(f"README.md must hold {BEGIN!r} and then {END!r}, once each")
    before, rest = readme.split(BEGIN)
    return f"{before}{BEGIN}\n\n{table.strip()}\n\n{END}{rest.split(END)[1]}"


def main() -> int:
    """Copy the table, or with no option say whether it is up to date (exit code 1 if not)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="change README.md")
    write = parser.parse_args().write
    old = README.read_text()
    new = with_table(old, TABLE.read_text())
    if write:
        README.write_text(new)
    sys.stdout.write(
        f"README.md: {'up to date' if old == new else 'changed' if write else 'old'}\n"
    )
    return int(old != new and not write)


if __name__ == "__main__":
    raise SystemExit(main())
