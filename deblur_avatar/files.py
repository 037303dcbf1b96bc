"""Files: written in one move, whole or not at all; numbers as JSON; what may not be read."""

import contextlib
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from deblur_avatar.errors import ArtifactError

MAX_VALUE = 2**63 - 1  # of whole numbers


@contextlib.contextmanager
def readable(path: Path) -> Iterator[None]:
    """Name a file or folder of a user's that is looked at within, where the disk refuses it.

    Raises:
        ArtifactError: if it may not be read, or cannot be.
    """
    try:
        yield
    except PermissionError as error:
        raise ArtifactError(
            f"{path} may not be read by you; allow it (chmod), or copy it to where you may read it"
        ) from error
    except OSError as error:
        raise ArtifactError(f"{path} cannot be read: {error.strerror or error}") from error


def write_json(path: Path, content: Any) -> None:
    """Write numbers as JSON in one move, rounded to 6 significant digits; NaN becomes null.

    Raises:
        ArtifactError: if the disk refuses.
    """
    write_text(path, json.dumps(_rounded(content), indent=1) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Read numbers that another stage wrote.

    Raises:
        ArtifactError: if the file is missing or damaged, or holds numbers that no tensor can.
    """
    try:
        content = json.loads(Path(path).read_text(), parse_int=_whole)
        json.dumps(content, allow_nan=False)  # JSON has no NaN; Python reads it
    except (OSError, ValueError, RecursionError) as error:
        raise ArtifactError(f"cannot read {path}: {error}; run `dvc repro`") from None
    if not isinstance(content, dict):
        raise ArtifactError(f"{path} holds a {type(content).__name__}; run `dvc repro`")
    return content


def write_text(path: Path, text: str) -> None:
    """Write a text file as `write_bytes` does."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file in one move: whole or not at all.

    Raises:
        ArtifactError: if the disk refuses.
    """
    path = Path(path)
    scratch = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch.write_bytes(content)
        scratch.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise ArtifactError(f"cannot write {path}: {error}") from error


def _whole(digits: str) -> int:
    """Parse an integer of JSON; one that does not fit into 64 bits is no number of a stage's."""
    value = int(digits)
    if not -MAX_VALUE <= value <= MAX_VALUE:
        raise ValueError(f"{digits:.20}... is no number that a stage writes")
    return value


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _rounded(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value
