"""Evaluation of deblurring in the picture: frames before and after it against the sharp ones.

Apart from `predeblur`, which may not see sharp frames.
"""

from pathlib import Path

from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.imaging import metrics


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
    names = [f"{key}_{which}" for which in ("blurred", "deblurred") for key in keys]
    if not (sharp / "manifest.json").is_file():
        return dict.fromkeys(names)
    frames = list(blurred.train)
    truth = Observations.load(sharp)
    wanted, matte = _unit(truth.frames[frames]), _unit(truth.mattes[frames])
    person = (matte > 0) | (blurred.mattes[frames] > 0)
    scores: list[Tensor] = []
    for made in (blurred, deblurred):
        pictures, coverage = _unit(made.frames[frames]), _unit(made.mattes[frames])
        layers = [c[..., None].expand(*c.shape, 3) for c in (coverage, matte)]
        scores += [
            metrics.psnr(pictures, wanted),
            metrics.psnr(pictures, wanted, person),
            metrics.psnr(layers[0], layers[1]),
        ]
    return {name: float(score.mean()) for name, score in zip(names, scores, strict=True)}


def _unit(codes: Tensor) -> Tensor:
    return codes.float() / 255
