"""The record that a benchmark prints, and keeps in a file where it is asked to."""

import json
from pathlib import Path
from typing import Any

from deblur_avatar.files import write_text


def print_record(record: Any, path: Path | None, indent: int = 2) -> None:
    """Print JSON, and write the same to a file in one move.

    Args:
        record: what was measured.
        path: of the file; None: no file.
        indent: spaces a level.
    """
    text = json.dumps(record, indent=indent)
    print(text)
    if path:
        write_text(path, text + "\n")
