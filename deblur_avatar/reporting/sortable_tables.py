"""Sortable tables: what a page needs besides its tables, so that their headings order the rows.

Without JavaScript tables are as they were written. A template takes `style` into its style and
`script` at its end.
"""

from pathlib import Path

SCRIPT = Path(__file__).parent / "sortable_tables.js"
STYLE = """\
th button { all: unset; cursor: pointer; }
th button:hover { color: var(--ink); }
th button:focus-visible { outline: 2px solid var(--accent); outline-offset: 2px; }
th[aria-sort] { color: var(--ink); box-shadow: inset 0 -3px var(--accent); }
"""


def sorting() -> dict[str, str]:
    """The `style` and the `script`, as a template's content."""
    return {"style": STYLE, "script": SCRIPT.read_text()}
