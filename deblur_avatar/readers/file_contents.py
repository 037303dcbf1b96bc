"""Digests of what files and folders hold, by which one tells whether they are still the same."""

import hashlib
from collections.abc import Collection
from pathlib import Path
from typing import Protocol

CHUNK = 1 << 20  # bytes that are read at a time


class Digest(Protocol):
    """What hashlib's functions give."""

    def update(self, data: bytes, /) -> None:
        """Take in more bytes."""


def add_contents(digest: Digest, path: Path, suffixes: Collection[str] | None = None) -> None:
    """Take in a file, or the files of a folder: their places in it, sizes and bytes.

    Args:
        digest: of `hashlib`.
        path: a file, or a folder with all below it.
        suffixes: of the files that count, with their dot; all, if None.

    Raises:
        OSError: if one of them cannot be read.
    """
    inside = sorted(one for one in path.rglob("*") if one.is_file()) if path.is_dir() else [path]
    for one in inside:
        if suffixes is None or one.suffix in suffixes:
            digest.update(f"{one.relative_to(path)} {one.stat().st_size}\n".encode())
            with one.open("rb") as file:
                while chunk := file.read(CHUNK):
                    digest.update(chunk)


def contents_digest(path: Path) -> str:
    """SHA-256, hexadecimal, of a file or a folder's files with their places in it.

    Raises:
        OSError: if one of them cannot be read.
    """
    digest = hashlib.sha256()
    add_contents(digest, path)
    return digest.hexdigest()
