"""Two-stage baseline: frames are deblurred in the picture first, then taken for sharp.

Frames come from a folder or a video where the user has put another program's results (a video
deblurring network's, say DSTNet's), else from a deblurrer of ours (`imaging/deblurring`). Poses,
cameras and the split are those of the blurred frames, and the exposure counts as nothing.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import expand_environment
from deblur_avatar.config.section import Params
from deblur_avatar.imaging.deblurring.deblurrer import Pictures
from deblur_avatar.imaging.deblurring.kinds import DeblurrerParams
from deblur_avatar.sources.deblurred_frames import read_deblurred


class PredeblurParams(Params):
    """Deblurring in the picture, for a baseline.

    `given` is a folder or a video of frames that another program has deblurred, and may hold
    `$(VARIABLE:-default)`; empty for the deblurrer.
    """

    given: str
    deblurrer: DeblurrerParams


def predeblur(
    blurred: Observations, params: PredeblurParams
) -> tuple[Observations, dict[str, Any]]:
    """Make sharper frames of blurred ones.

    Deblurrers treat mattes as colours, since a sharp picture within a soft matte would teach an
    avatar edges that its coverage denies. Of given frames mattes stay as they are.

    Returns:
        The observations, and by which method they were made.

    Raises:
        ArtifactError: if given frames, or a deblurrer's files, are missing or damaged.
        ConfigError: if a path names an environment variable that is not set.
    """
    given = expand_environment(params.given, "predeblur.given")
    if given:
        frames = read_deblurred(Path(given), blurred.frames, "predeblur.given")
        return replace(blurred, frames=frames, exposure=0.0), {"method": "given"}
    pictures = Pictures(blurred.frames, blurred.mattes)
    made, noted = params.deblurrer.deblur(pictures, blurred.averaging_space, clips_of(blurred))
    used = {"method": params.deblurrer.kind, **noted}
    return replace(blurred, frames=made.frames, mattes=made.mattes, exposure=0.0), used


def clips_of(blurred: Observations) -> list[slice]:
    """Runs of frames that are all fitted or validated on, or all not.

    So nothing of the part of a clip that is kept from fitting comes into frames that are fitted,
    by way of a deblurrer that looks at a frame's neighbours.
    """
    shown = set(blurred.train) | set(blurred.validation)
    count = len(blurred.frames)
    starts = [i for i in range(count) if i == 0 or (i in shown) != (i - 1 in shown)]
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], count], strict=True)]
