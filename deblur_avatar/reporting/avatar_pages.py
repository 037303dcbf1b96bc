"""Avatar pages in a report: of each scene the best method's, as `export` wrote it.

A page is a file of its own beside the report, which shows it in a frame once a reader asks: it
draws with WebGL, keeps its own address, and can be passed on by itself.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.metrics import HEADLINE
from deblur_avatar.reporting.results_table import BOUNDS, look_up

PAGES = "*.html"  # among the files that `export` wrote
MAX_BYTES = 4_000_000  # of a page that goes along; the schedule `large` makes about 1.3 MB
RANKED_BY = (("image", HEADLINE), ("reblur", "psnr"))  # with and without a sharp truth, dB


@dataclass(frozen=True)
class AvatarPage:
    """A page that goes along with the report."""

    run: str
    method: str
    content: bytes

    @property
    def file(self) -> str:
        """Its name beside the report."""
        return f"{self.run}.html"


def best_page(
    scene: str, results: Mapping[str, Mapping[str, Any]], exports: Path, exported: Collection[str]
) -> AvatarPage | None:
    """The page of the best method that has one; bounds, which saw sharp frames, do not count.

    Args:
        scene: whose runs are `<scene>-<method>`.
        results: by method.
        exports: what `export` wrote, one folder a run.
        exported: names of the runs that are exported; nothing else that lies there counts.

    Returns:
        None if no run has a page here, or the best one's is too large to go along.

    Raises:
        ArtifactError: if a page cannot be read.
    """
    found = {}
    for method in results:
        run = f"{scene}-{method}"
        paths = sorted((exports / run).glob(PAGES)) if run in exported else []
        if method not in BOUNDS and paths:
            found[method] = paths[0]
    if not found:
        return None
    best = max(found, key=lambda method: _quality(results[method]))
    try:
        content = found[best].read_bytes()
    except OSError as error:
        raise ArtifactError(f"cannot read {found[best]}: {error}; run `dvc repro`") from None
    return AvatarPage(f"{scene}-{best}", best, content) if len(content) <= MAX_BYTES else None


def _quality(result: Mapping[str, Any]) -> float:
    """What methods of one scene are ranked by, dB."""
    numbers = (look_up(result, path) for path in RANKED_BY)
    return next((number for number in numbers if number is not None), float("-inf"))
