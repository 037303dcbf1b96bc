"""Trimmed mattes: people as detectors found them, without the background that is known."""

from collections.abc import Sequence
from dataclasses import replace

from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.body_estimation.limb_capsules import limb_capsules
from deblur_avatar.imaging.backgrounds import Background, BackgroundEstimator, BackgroundKind
from deblur_avatar.imaging.matting import trim_mattes
from deblur_avatar.imaging.own_colors import own_colors


def without_background(
    films: UInt8[Tensor, "C F H W 3"],
    row: int,
    kind: BackgroundKind,
    people: Sequence[Landmarks],
    scenes: Sequence[BackgroundEstimator],
    *,
    by_limbs: bool,
) -> tuple[list[Landmarks], BackgroundKind]:
    """Every camera's mattes trimmed; the training camera settles the kind for all of them.

    Args:
        films: frames of the cameras that recorded.
        row: of the training camera among them.
        kind: of background, as asked for.
        people: one person, camera by camera.
        scenes: the same cameras' backgrounds.
        by_limbs: as in `trimmed`.
    """
    settled = scenes[row].background(kind, people[row].mattes)
    alone = []
    for index, (frames, person) in enumerate(zip(films, people, strict=True)):
        background = settled
        if index != row:
            background = scenes[index].background(settled.kind, person.mattes)
        alone.append(trimmed(frames, person, background, by_limbs=by_limbs))
    return alone, settled.kind


def trimmed(
    frames: UInt8[Tensor, "F H W 3"], person: Landmarks, background: Background, *, by_limbs: bool
) -> Landmarks:
    """The person, the mattes trimmed where the background is known.

    Args:
        frames: of one camera.
        person: found there.
        background: behind her.
        by_limbs: not where landmarks say there is a limb of the background's colour.
    """
    if background.plates is None or background.kind == "matte":  # known nowhere
        return person
    untold = None
    if by_limbs:
        untold = own_colors(frames, limb_capsules(person), background.light).shared_with
    return replace(person, mattes=trim_mattes(frames, person.mattes, background.plates, untold))
