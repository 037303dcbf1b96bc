"""Evaluation of deblurring in the picture: frames before and after it against the sharp ones.

Apart from `predeblur`, which may not see sharp frames.
"""

from pathlib import Path

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.evaluation.deblurring_measures import deblurring_measures
from deblur_avatar.imaging.deblurring.deblurrer import Pictures


def score_predeblur(
    deblurred: Observations, blurred: Observations, sharp: Path
) -> dict[str, float | None]:
    """How far frames and mattes are from the sharp ones, before and after; means over frames.

    Over the training camera's training frames; PSNR in dB, that of `person` over the pixels that
    the person covers in the sharp or the blurred frame. None where no sharp frames are known.

    Args:
        deblurred: what was made.
        blurred: of what.
        sharp: folder of the sharp observations, empty where there are none.
    """
    keys = ("psnr", "psnr_person", "psnr_matte")
    if not (sharp / "manifest.json").is_file():
        return dict.fromkeys(f"{key}_{which}" for which in ("blurred", "deblurred") for key in keys)
    frames = list(blurred.train)
    truth = Observations.load(sharp)
    given, made, wanted = (
        Pictures(some.frames[frames], some.mattes[frames]) for some in (blurred, deblurred, truth)
    )
    before, after = (deblurring_measures(one, given, wanted) for one in (given, made))
    return {
        f"{key}_{which}": float(scores[key].mean())
        for which, scores in (("blurred", before), ("deblurred", after))
        for key in keys
    }
