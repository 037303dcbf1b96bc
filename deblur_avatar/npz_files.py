"""Arrays from other people's `.npz` files: zip archives, which a few bytes can make huge."""

import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deblur_avatar.errors import ArtifactError

MOST_BYTES = 1 << 30  # of all arrays that are wanted, unfolded


def load_npz(path: Path, wanted: Collection[str]) -> dict[str, NDArray[Any]]:
    """Read those arrays of an archive that are wanted and there; no pickled objects.

    Raises:
        ArtifactError: if the file is missing, damaged, or unfolds to more than `MOST_BYTES`.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
        size = sum(m.file_size for m in members if m.filename.removesuffix(".npy") in wanted)
        if size > MOST_BYTES:
            raise ArtifactError(
                f"{path} unfolds to {size >> 20} MB, at most {MOST_BYTES >> 20} MB are read; "
                "is it the file it should be?"
            )
        with np.load(path, allow_pickle=False) as arrays:
            return {key: arrays[key] for key in arrays.files if key in wanted}
    except ArtifactError:
        raise
    except OSError as error:
        raise ArtifactError(f"cannot read {path}: {error.strerror or error}") from None
    except Exception as error:
        # A damaged archive can raise nearly anything from inside zipfile, zlib and numpy.
        raise ArtifactError(f"{path} is not a readable .npz file: {error!r}") from None
