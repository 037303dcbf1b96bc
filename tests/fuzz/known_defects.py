"""Hostile files that readers are known to get wrong.

Each is a strict expected failure of the tests: whoever mends the reader takes its entry away.
"""

import json
from dataclasses import dataclass


@dataclass(frozen=True)
class Defect:
    """One input, and where its reader fails."""

    reader: str  # of the registry
    file: str
    content: bytes
    place: str  # where failures of this defect lie: the beginning of their names
    reason: str


KNOWN: tuple[Defect, ...] = (
    Defect(
        "views",
        "views.json",
        json.dumps([{"camera": "a", "frame": 3}]).encode(),
        "pipeline/picture_strips.py",
        "an entry of views.json without its pictures is a KeyError, not an ArtifactError",
    ),
    Defect(
        "LPIPS weights",
        "vgg.pth",
        b"\x80\x04})" + b"\x85" * 1_000_000 + b"K\x01s.",
        "input ",
        "torch's reader of weights hashes a tuple in a million tuples and overflows the C stack",
    ),
    Defect(
        "own avatar",
        "avatars/me/params.yaml",
        b"a: [",
        "pipeline/own_video.py",
        "an avatar's own params.yaml is read past `read_yaml` and its sections are not checked",
    ),
)


def unknown(reader: str, failures: dict[str, str]) -> dict[str, str]:
    """The failures of a reader that no known defect explains."""
    places = tuple(defect.place for defect in KNOWN if defect.reader == reader)
    return {place: what for place, what in failures.items() if not place.startswith(places)}
