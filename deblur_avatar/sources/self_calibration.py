"""Self-calibration: the focal length of a moving camera, from the background it moves past.

Structure from motion with pycolmap. The person is masked out. A camera that stands still tells
nothing, and then there is no answer rather than a guess.

Frames come one after the other, so that each is matched with its neighbours and with some farther
off (1, 2, 4 ... frames), not with all. The way is looked for twice, with two seeds: on a
short way a wrong focal length can fit nearly as well as the right one, and seeds tell.
"""

import contextlib
import logging
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.imaging.camera_motion import background_mask
from deblur_avatar.imaging.picture_files import write_picture

logger = logging.getLogger(__name__)

MAX_FRAMES = 40  # of a clip, that are placed
NEIGHBOURS = 6  # frames that each is matched with on either side, and powers of two up to 2^5
LONGEST_SIDE = 960  # pixels; larger frames tell no more and take longer
SHARE_PLACED = 0.5  # of the frames that must be placed for the answer to be believed
FIRST_GUESS = 1.0  # of the picture's longer side
PLAUSIBLE = (0.4, 5.0)  # of the picture's longer side
SEEDS = (1, 2)  # of RANSAC; the ways of the camera that they find must agree
MAX_ERROR = 2.0  # pixels, mean reprojection error
AGREEMENT = 0.1  # of the focal length, by which one seed's may be longer than the other's


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
    logger.info("the camera moves: its focal length is looked for in %d frames", len(chosen))
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
        pycolmap.set_random_seed(SEEDS[0])
        reader = pycolmap.ImageReaderOptions(
            camera_model="SIMPLE_RADIAL",
            mask_path=folder / "masks",
            default_focal_length_factor=FIRST_GUESS,
        )
        database = folder / "database.db"
        features = pycolmap.FeatureExtractionOptions()
        features.max_image_size = LONGEST_SIDE
        pairs = pycolmap.SequentialPairingOptions()
        pairs.overlap, pairs.quadratic_overlap = NEIGHBOURS, True
        pycolmap.extract_features(
            database,
            folder / "frames",
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader,
            extraction_options=features,
            device=pycolmap.Device.cpu,
        )
        pycolmap.match_sequential(database, pairing_options=pairs, device=pycolmap.Device.cpu)
        found = []
        for seed in SEEDS:
            (models := folder / "models" / str(seed)).mkdir()
            options = pycolmap.IncrementalPipelineOptions(random_seed=seed, multiple_models=False)
            way = pycolmap.incremental_mapping(database, folder / "frames", models, options=options)
            found.append(_answer(way, len(chosen), longer))
        return _agreed(found)


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


def _agreed(found: Sequence[tuple[float | None, str]]) -> tuple[float | None, str]:
    """The first seed's answer, or none where one has none or they are too far apart."""
    for focal, why in found:
        if focal is None:
            return None, why
    focals = [focal for focal, _ in found if focal is not None]
    if max(focals) > (1 + AGREEMENT) * min(focals):
        each = " and ".join(f"{focal:.0f}" for focal in focals)
        return None, f"structure from motion does not agree with itself: focal {each} px"
    return found[0]


@contextlib.contextmanager
def _quiet(pycolmap: Any) -> Iterator[None]:
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = level
