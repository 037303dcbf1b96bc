"""Self-calibration: the focal length of a moving camera, from the background it moves past.

Structure from motion with pycolmap. The person is masked out. A camera that stands still tells
nothing, and then there is no answer rather than a guess.
"""

import contextlib
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.imaging.camera_motion import background_mask
from deblur_avatar.imaging.picture_files import write_picture

MAX_FRAMES = 40  # matched with each other
SHARE_PLACED = 0.5  # of the frames that must be placed for the answer to be believed
FIRST_GUESS = 1.0  # of the picture's longer side
PLAUSIBLE = (0.4, 5.0)  # of the picture's longer side
SEED = 1  # of RANSAC
MAX_ERROR = 2.0  # pixels, mean reprojection error


def calibrate_focal(
    frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"]
) -> tuple[float | None, str]:
    """Estimate the focal length in pixels of these frames.

    Returns:
        The focal length or None, and in words how it was found or why it was not.
    """
    import pycolmap  # 134 MB of libraries, for those alone who need them

    chosen = np.linspace(0, len(frames) - 1, min(MAX_FRAMES, len(frames))).round().astype(int)
    longer = max(frames.shape[1:3])
    with tempfile.TemporaryDirectory() as scratch, _quiet(pycolmap):
        folder = Path(scratch)
        for kind in ("frames", "masks", "models"):
            (folder / kind).mkdir()
        for index in chosen:
            name = f"{index:06d}.png"
            write_picture(folder / "frames" / name, frames[index].numpy())
            background = background_mask(mattes[index]).numpy()[..., None]
            white = np.where(background, np.uint8(255), np.uint8(0)).repeat(3, axis=2)
            write_picture(folder / "masks" / f"{name}.png", white)
        pycolmap.set_random_seed(SEED)
        reader = pycolmap.ImageReaderOptions(
            camera_model="SIMPLE_RADIAL",
            mask_path=folder / "masks",
            default_focal_length_factor=FIRST_GUESS,
        )
        database = folder / "database.db"
        pycolmap.extract_features(
            database,
            folder / "frames",
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader,
            device=pycolmap.Device.cpu,
        )
        pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
        options = pycolmap.IncrementalPipelineOptions(random_seed=SEED, multiple_models=False)
        models = pycolmap.incremental_mapping(
            database, folder / "frames", folder / "models", options=options
        )
        return _answer(models, len(chosen), longer)


def _answer(models: Mapping[int, Any], count: int, longer: int) -> tuple[float | None, str]:
    if not models:
        return None, "structure from motion found no way of the camera in the background"
    model = max(models.values(), key=lambda m: m.num_reg_images())
    placed, error = model.num_reg_images(), model.compute_mean_reprojection_error()
    focal = float(next(iter(model.cameras.values())).mean_focal_length())
    found = f"{placed} of {count} frames placed, error {error:.2f} px, focal {focal:.0f} px"
    if placed < SHARE_PLACED * count or error > MAX_ERROR:
        return None, f"structure from motion is not to be believed: {found}"
    if not PLAUSIBLE[0] * longer <= focal <= PLAUSIBLE[1] * longer:
        return None, f"structure from motion gave an implausible focal length: {found}"
    return focal, f"self-calibrated: {found}"


@contextlib.contextmanager
def _quiet(pycolmap: Any) -> Iterator[None]:
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = level
