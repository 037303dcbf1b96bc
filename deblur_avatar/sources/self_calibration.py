"""Self-calibration: the focal length of a moving camera, from the background it moves past.

Structure from motion with pycolmap. The person is masked out. A camera that stands still, or turns
or drifts in one place, tells nothing, and then there is no answer rather than a guess.

Frames come one after the other, so that each is matched with its neighbours and with some farther
off (1, 2, 4 ... frames), not with all. The way is looked for twice from the same features, side by
side, each look with draws of its own when it verifies matches and when it places cameras: on a
short way a wrong focal length can fit nearly as well as the right one, and two looks tell.
"""

import contextlib
import logging
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from statistics import geometric_mean
from typing import Any

import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.imaging.camera_motion import background_mask
from deblur_avatar.imaging.parallax import has_parallax
from deblur_avatar.imaging.picture_files import write_picture

logger = logging.getLogger(__name__)

FRAMES, MASKS, DATABASE = "frames", "masks", "database.db"
MAX_FRAMES = 40  # of a clip, that are placed
NEIGHBOURS = 6  # frames that each is matched with on either side, and powers of two up to 2^5
LONGEST_SIDE = 960  # pixels; larger frames tell no more and take longer
SHARE_PLACED = 0.5  # of the frames that must be placed for the answer to be believed
FIRST_GUESS = 1.0  # of the picture's longer side
PLAUSIBLE = (0.4, 5.0)  # of the picture's longer side
SEEDS = (1, 2)  # one for each look; the focal lengths that they find must agree
# Pixels, mean reprojection error: 0.4 where looks agreed on a focal length; through a rolling
# shutter it was 0.9 to 1.3, and the focal length 8 to 45 % off (docs/decisions/0051).
MAX_ERROR = 0.75
GROWTH = 1.3  # of frames or points, after which all is adjusted again
AGREEMENT = 0.1  # of the focal length, by which one look's may be longer than the other's


def calibrate_focal(
    frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"]
) -> tuple[float | None, str]:
    """Estimate the focal length in pixels of these frames.

    Returns:
        The focal length or None, and in words how it was found or why it was not.
    """
    if not has_parallax(frames, mattes):
        return None, "the camera turned or drifted in one place, which does not tell it"
    import pycolmap  # 134 MB of libraries, for those alone who need them

    chosen = evenly_spaced(range(len(frames)), MAX_FRAMES)
    logger.info("the camera moves: its focal length is looked for in %d frames", len(chosen))
    with tempfile.TemporaryDirectory() as scratch, _quiet(pycolmap):
        folder = Path(scratch)
        _write_pictures(folder, frames[chosen], mattes[chosen])
        _match(folder)
        logger.info("self-calibration: the camera's way")
        models = _looks(folder)
        longer = max(frames.shape[1:3])
        return _agreed([_answer(model, len(chosen), longer) for model in models])


def _write_pictures(
    folder: Path, frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"]
) -> None:
    for kind in (FRAMES, MASKS):
        (folder / kind).mkdir()
    for index, (frame, matte) in enumerate(zip(frames, mattes, strict=True)):
        name = f"{index:06d}.png"
        write_picture(folder / FRAMES / name, frame.numpy())
        background = background_mask(matte).numpy()[..., None]
        white = np.where(background, np.uint8(255), np.uint8(0)).repeat(3, axis=2)
        write_picture(folder / MASKS / f"{name}.png", white)


def _match(folder: Path) -> None:
    """Features and their matches, which nothing is drawn for.

    On one thread: several share their search trees, and found other matches in 7 runs of 100.
    """
    import pycolmap

    reader = pycolmap.ImageReaderOptions(
        camera_model="SIMPLE_PINHOLE",
        mask_path=folder / MASKS,
        default_focal_length_factor=FIRST_GUESS,
    )
    one_camera = pycolmap.CameraMode.SINGLE
    # First by themselves, in order: threads that extract would number them as they come.
    pycolmap.Database.open(folder / DATABASE).close()
    pycolmap.import_images(folder / DATABASE, folder / FRAMES, one_camera, options=reader)
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.max_image_size = LONGEST_SIDE
    logger.info("self-calibration: features of the background")
    pycolmap.extract_features(
        folder / DATABASE,
        folder / FRAMES,
        camera_mode=one_camera,
        reader_options=reader,
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    matching = pycolmap.FeatureMatchingOptions()
    matching.skip_geometric_verification = True
    matching.num_threads = 1
    pairs = pycolmap.SequentialPairingOptions()
    pairs.overlap, pairs.quadratic_overlap = NEIGHBOURS, True
    logger.info("self-calibration: matches between frames")
    pycolmap.match_sequential(
        folder / DATABASE,
        matching_options=matching,
        pairing_options=pairs,
        device=pycolmap.Device.cpu,
    )


def _looks(folder: Path) -> list[Mapping[int, Any]]:
    """What each seed finds, side by side; an interrupt ends them, which they would not see."""
    import pycolmap

    stop = pycolmap.CancellationToken()
    with ThreadPoolExecutor(len(SEEDS)) as looks:
        try:
            return list(looks.map(partial(_look, folder, stop), SEEDS))
        except BaseException:
            stop.cancel()
            raise


def _look(folder: Path, stop: Any, seed: int) -> Mapping[int, Any]:
    """Verify matches and place cameras: ways by number, none if none is found.

    One thread, so that the same seed gives the same bits.
    """
    import pycolmap

    database, found = folder / f"{seed}.db", folder / f"ways_{seed}"
    shutil.copy(folder / DATABASE, database)
    found.mkdir()
    verifier = pycolmap.GeometricVerifierOptions()
    verifier.num_threads = 1
    geometry = pycolmap.TwoViewGeometryOptions()
    geometry.ransac.random_seed = seed
    pycolmap.geometric_verification(
        database,
        verifier_options=verifier,
        two_view_geometry_options=geometry,
        cancellation_token=stop,
    )
    options = pycolmap.IncrementalPipelineOptions(random_seed=seed, multiple_models=False)
    options.num_threads = 1
    options.ba_global_frames_ratio = options.ba_global_points_ratio = GROWTH
    ways: Mapping[int, Any] = pycolmap.incremental_mapping(
        database, folder / FRAMES, found, options=options, cancellation_token=stop
    )
    return ways


def _answer(models: Mapping[int, Any], count: int, longer: int) -> tuple[float | None, str]:
    if not models:
        return None, "structure from motion found no way of the camera in the background"
    model = max(models.values(), key=lambda m: m.num_reg_images())
    placed, error = model.num_reg_images(), model.compute_mean_reprojection_error()
    focal = float(next(iter(model.cameras.values())).mean_focal_length())
    way = f"{placed} of {count} frames placed, error {error:.2f} px"
    found = f"{way}, focal {focal:.0f} px"
    if placed < SHARE_PLACED * count or error > MAX_ERROR:
        return None, f"structure from motion is not to be believed: {found}"
    if not PLAUSIBLE[0] * longer <= focal <= PLAUSIBLE[1] * longer:
        return None, f"structure from motion gave an implausible focal length: {found}"
    return focal, f"self-calibrated: {way}"


def _agreed(found: Sequence[tuple[float | None, str]]) -> tuple[float | None, str]:
    """The looks' geometric mean, or none where one found none or they are too far apart."""
    for focal, why in found:
        if focal is None:
            return None, why
    focals = [focal for focal, _ in found if focal is not None]
    each = " and ".join(f"{focal:.0f}" for focal in focals)
    if max(focals) > (1 + AGREEMENT) * min(focals):
        return None, f"structure from motion does not agree with itself: focal {each} px"
    mean = geometric_mean(focals)
    return mean, f"{found[0][1]}, focal {mean:.0f} px (looks: {each})"


@contextlib.contextmanager
def _quiet(pycolmap: Any) -> Iterator[None]:
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = level
