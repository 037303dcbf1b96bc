"""What may stand where a file is wanted: nothing, a folder, a link.

Pipes and devices are left out: who names one has a program wait, or read for ever, by design."""

import shutil
from collections.abc import Callable
from pathlib import Path

SOUND_LINK = "a link to the file"  # DVC's cache may be linked so: it must be read


def _link(path: Path, content: bytes) -> None:
    elsewhere = path.parent.parent / "elsewhere"
    elsewhere.write_bytes(content)
    path.symlink_to(elsewhere)


ODD: dict[str, Callable[[Path, bytes], object]] = {
    "nothing": lambda path, content: None,
    "a folder": lambda path, content: path.mkdir(),
    "a link to nowhere": lambda path, content: path.symlink_to("nowhere"),
    "a link to itself": lambda path, content: path.symlink_to(path.name),
    "a link to a folder": lambda path, content: path.symlink_to("/tmp"),
    SOUND_LINK: _link,
}


def clear(path: Path) -> None:
    """Take away whatever is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
