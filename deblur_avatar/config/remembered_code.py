"""Remembered code hashes: not worked out again while no file of the code has changed.

To parse all modules takes seconds, and DVC asks whenever it runs. What was found is kept in a
folder's `.dvc/tmp`, under a hash over the bytes of every file that it could depend on.
"""

import contextlib
import hashlib
import platform
from collections.abc import Iterable
from pathlib import Path

from pydantic import BaseModel, ValidationError

MEMORY = Path(".dvc/tmp/code_hashes.json")


class Hashes(BaseModel):
    """Fingerprints of all scripts by name, and of all kinds by section and name."""

    scripts: dict[str, str]
    kinds: dict[str, dict[str, str]]


class _Memory(BaseModel):
    """Hashes, and the state of the code that they are of."""

    state: str
    hashes: Hashes


def state_of(folders: Iterable[Path]) -> str:
    """A hash over names and bytes of all files below folders, and over the Python that parses."""
    digest = hashlib.sha256(platform.python_version().encode())
    for folder in folders:
        for path in sorted(folder.rglob("*")):
            if "__pycache__" not in path.parts and path.is_file():
                content = hashlib.sha256(path.read_bytes()).hexdigest()
                digest.update(f"{path}\0{content}\n".encode())
    return digest.hexdigest()


def recalled(folder: Path, state: str) -> Hashes | None:
    """What a folder remembers of this state of the code; None if nothing."""
    try:
        memory = _Memory.model_validate_json((folder / MEMORY).read_bytes())
    except (OSError, ValidationError):
        return None
    return memory.hashes if memory.state == state else None


def remember(folder: Path, state: str, hashes: Hashes) -> None:
    """Keep hashes where DVC keeps what is nobody else's, if DVC has been there.

    Half a file is as good as none: it cannot be read, and they are worked out again.
    """
    with contextlib.suppress(OSError):
        (folder / MEMORY).write_text(_Memory(state=state, hashes=hashes).model_dump_json())
