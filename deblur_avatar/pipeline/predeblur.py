"""Two-stage baseline: frames are deblurred in the picture first, then taken for sharp.

Frames come from a folder where the user has put another program's results (a video deblurring
network's, say DSTNet's), else from a classical method (`imaging/deconvolution.py`). Poses, cameras
and the split are those of the blurred frames, and the exposure counts as nothing.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import torch
from jaxtyping import UInt8
from pydantic import Field
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import expand_environment
from deblur_avatar.config.section import (
    Count,
    Fraction,
    Params,
    Positive,
)
from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear
from deblur_avatar.imaging.deconvolution import deblur_by_matte
from deblur_avatar.imaging.picture_files import read_picture


class PredeblurParams(Params):
    """Deblurring in the picture, for a baseline (imaging/deconvolution.py).

    `given` is a folder of frames that another program has deblurred, and may hold
    `$(VARIABLE:-default)`; empty for the classical method, which the rest is for.
    """

    given: str
    lengths: Annotated[tuple[Positive, ...], Field(min_length=1)]  # of the line PSFs tried, pixels
    angles: Count  # directions tried
    regularisation: Positive  # weight of smoothness against closeness
    window_sigma: Positive  # pixels, of the Gaussian window in which the matte is judged
    gain: Fraction  # by which the matte must become clearer


MARGIN = 16  # pixels around the person in which anything is changed


def predeblur(
    blurred: Observations, params: PredeblurParams
) -> tuple[Observations, dict[str, Any]]:
    """Make sharper frames of blurred ones.

    The classical method puts mattes through the same filters as the colours, since a sharp picture
    within a soft matte would teach an avatar edges that its coverage denies; the filters are chosen
    by the matte in any case. For given frames, of which no filter is known, mattes stay.

    Returns:
        The observations, and by which method they were made.

    Raises:
        ArtifactError: if given frames are missing or of another size.
        ConfigError: if `given` names an environment variable that is not set.
    """
    given = expand_environment(params.given, "predeblur.given")
    if given:
        frames = _given_frames(Path(given), blurred)
        return replace(blurred, frames=frames, exposure=0.0), {"method": "given"}
    frames, mattes = blurred.frames.clone(), blurred.mattes.clone()
    lengths = []
    for index in range(len(frames)):
        box = _box(blurred.mattes[index])
        if box is not None:
            made = _sharpened(
                frames[index][box], mattes[index][box], blurred.averaging_space, params
            )
            frames[index][box], mattes[index][box], length = made
            lengths.append(length)
    mean = sum(lengths) / len(lengths) if lengths else None
    used = {"method": "matte", "streak_px": mean}
    return replace(blurred, frames=frames, mattes=mattes, exposure=0.0), used


def _sharpened(
    frame: UInt8[Tensor, "H W 3"],
    matte: UInt8[Tensor, "H W"],
    averaging_space: str,
    params: PredeblurParams,
) -> tuple[UInt8[Tensor, "H W 3"], UInt8[Tensor, "H W"], float]:
    """One frame's box, and how long its PSFs are where the person is, pixels."""
    colors = _unit(frame)
    colors = srgb_to_linear(colors) if averaging_space == "linear" else colors
    coverage = _unit(matte)
    layers, lengths = deblur_by_matte(
        torch.cat([colors.permute(2, 0, 1), coverage[None]]),
        params.lengths, params.angles,
        regularisation=params.regularisation, window_sigma=params.window_sigma, gain=params.gain,
    )  # fmt: skip
    colors = layers[:3].permute(1, 2, 0)
    colors = linear_to_srgb(colors) if averaging_space == "linear" else colors
    mean = float((lengths * coverage).sum() / coverage.sum())
    return _codes(colors), _codes(layers[3]), mean


def _given_frames(folder: Path, blurred: Observations) -> UInt8[Tensor, "F H W 3"]:
    """All pictures of a folder in the order of their names."""
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in (".png", ".jpg"))
    if len(files) != len(blurred.frames):
        raise ArtifactError(
            f"predeblur.given: {folder} holds {len(files)} pictures, wanted "
            f"{len(blurred.frames)}: one for each of the blurred observations' frames, in order"
        )
    pictures = [torch.from_numpy(read_picture(file)) for file in files]
    for file, picture in zip(files, pictures, strict=True):
        if picture.shape != blurred.frames.shape[1:]:
            height, width = blurred.frames.shape[1:3]
            raise ArtifactError(
                f"predeblur.given: {file} is {picture.shape[1]} x {picture.shape[0]} pixels, "
                f"the blurred frames are {width} x {height}; deblur those, uncropped"
            )
    return torch.stack(pictures)


def _box(matte: UInt8[Tensor, "H W"]) -> tuple[slice, slice] | None:
    rows, columns = torch.nonzero(matte > 0, as_tuple=True)
    if len(rows) == 0:
        return None
    top, left = max(int(rows.min()) - MARGIN, 0), max(int(columns.min()) - MARGIN, 0)
    return slice(top, int(rows.max()) + MARGIN + 1), slice(left, int(columns.max()) + MARGIN + 1)


def _unit(codes: Tensor) -> Tensor:
    return codes.float() / 255


def _codes(values: Tensor) -> Tensor:
    return (values * 255).round().to(torch.uint8)
