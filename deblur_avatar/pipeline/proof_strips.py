"""The proof's pictures, kept in the repository as they come.

A page is written where tables are, pictures are where a cell was fitted: on one machine a scene, on
another an avatar. So strips gather beside the page, and the page shows all that there are.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from deblur_avatar.config.proof import ProofParams
from deblur_avatar.evaluation.proof_grid import Found, in_main_schedule
from deblur_avatar.reporting.kept_strips import KeptStrips, keep_strips, read_strips
from deblur_avatar.reporting.picture_strips import strips_of_scene
from deblur_avatar.reporting.proof_tables import MAIN

SHOWN = ("agnostic", "paper", "clip")  # of each avatar, where it was fitted
VIEWS = 2  # of the test views of each scene


def gather_strips(
    plan: ProofParams, found: Sequence[Found], pictures: Path, kept: Path
) -> list[str]:
    """Keep the pictures of the cells that were fitted here.

    An avatar's strips are replaced by those that show no fewer of its motions.

    Args:
        plan: which scenes and avatars there are, and which scenes show nothing.
        found: cells with results.
        pictures: `<scene>/evaluate/<cell>`, as `evaluate` left them.
        kept: strips, `<scene>/<avatar>`.

    Returns:
        What was kept, a line an avatar.

    Raises:
        ArtifactError: if pictures or strips are damaged, or the disk refuses.
    """
    kept.mkdir(parents=True, exist_ok=True)  # DVC asks for it even where there is no picture
    lines = []
    for scene in _shown_scenes(plan, found):
        for avatar in plan.avatars:
            fits = shown_fits(found, scene, avatar)
            folders = {m: pictures / scene / "evaluate" / one.cell.name for m, one in fits.items()}
            there = {motion: folder for motion, folder in folders.items() if folder.is_dir()}
            before = current_strips(kept, found, scene, avatar)
            if not there or (before and before.fits.keys() - there.keys()):
                continue
            quality = {motion: quality_of(fits[motion]) for motion in there}
            keep_strips(kept / scene / avatar, strips_of_scene(there, VIEWS), quality)
            lines.append(f"{scene}, {avatar}: {', '.join(there)}")
    return lines


def current_strips(
    kept: Path, found: Sequence[Found], scene: str, avatar: str
) -> KeptStrips | None:
    """An avatar's strips without the motions whose fit is not the one that tables have.

    Raises:
        ArtifactError: if they are damaged.
    """
    strips = read_strips(kept / scene / avatar)
    if strips is None:
        return None
    fits = shown_fits(found, scene, avatar)
    same = {
        motion: quality
        for motion, quality in strips.fits.items()
        if motion in fits and quality_of(fits[motion]) == quality
    }
    return replace(strips, fits=same) if same else None


def shown_fits(found: Sequence[Found], scene: str, avatar: str) -> dict[str, Found]:
    """An avatar's fits that strips show: each motion's first seed in the scene's main schedule."""
    of = [one for one in in_main_schedule(found, scene) if one.cell.avatar == avatar]
    first = {one.cell.motion: one for one in reversed(of)}
    return {motion: first[motion] for motion in SHOWN if motion in first}


def quality_of(one: Found) -> float | None:
    """PSNR of the seen surface, dB, by which a fit is known again; None where no pixel was seen."""
    quality: float | None = one.result["image"][MAIN]
    return quality


def _shown_scenes(plan: ProofParams, found: Sequence[Found]) -> list[str]:
    there = {one.cell.scene for one in found}
    return [s for s in plan.scenes if s in there and s not in plan.without_pictures]
