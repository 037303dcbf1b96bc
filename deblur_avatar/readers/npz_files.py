"""Arrays from other people's `.npz` files: zip archives, which a few bytes can make huge."""

import math
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from deblur_avatar.errors import ArtifactError

MAX_BYTES = 1 << 30  # of all arrays that are wanted, unfolded


def load_npz(path: Path, wanted: Collection[str]) -> dict[str, NDArray[Any]]:
    """Read those arrays of an archive that are wanted and there; no pickled objects.

    Raises:
        ArtifactError: if the file is missing, damaged, or unfolds to more than `MAX_BYTES`.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            size = sum(m.file_size for m in members if m.filename.removesuffix(".npy") in wanted)
            if size > MAX_BYTES:
                raise ArtifactError(
                    f"{path} unfolds to {size >> 20} MB, at most {MAX_BYTES >> 20} MB are read; "
                    "is it the file it should be?"
                )
            for member in members:
                if member.filename.removesuffix(".npy") in wanted:
                    with archive.open(member) as file:
                        _check_claim(file, member.file_size)
        with np.load(path, allow_pickle=False) as arrays:
            return {key: arrays[key] for key in arrays.files if key in wanted}
    except ArtifactError:
        raise
    except OSError as error:
        raise ArtifactError(f"cannot read {path}: {error.strerror or error}") from None
    except Exception as error:
        # A damaged archive can raise nearly anything from inside zipfile, zlib and numpy.
        raise ArtifactError(f"{path} is not a readable .npz file: {error!r}") from None


def _check_claim(file: IO[bytes], size: int) -> None:
    """Refuse a member that is no array, or one whose header claims more than there is."""
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(file)
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > size:
        raise ValueError(f"an array of shape {shape!s:.60} does not fit into {size} bytes")
