"""Network weights (`.pth`) of other people, which are known by their SHA-256.

A pickle can run anything, and torch's own restricted reader can still be made to end the process.
So nothing of a file is looked at before it is known to be the one that was published.
"""

import hashlib
from pathlib import Path

import torch
from torch import Tensor

from deblur_avatar.errors import ArtifactError


def load_pth(path: Path, sha256: str) -> dict[str, Tensor]:
    """Read the tensors by name of one published file, on the CPU.

    Args:
        path: of it.
        sha256: of the published file, hexadecimal.

    Raises:
        ArtifactError: if the file is missing or another one.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
            if found != sha256:
                raise ArtifactError(
                    f"{path} is not the published file: its SHA-256 is {found[:16]}..., wanted "
                    f"{sha256[:16]}...; take the file from its publisher"
                )
            file.seek(0)
            tensors: dict[str, Tensor] = torch.load(file, map_location="cpu", weights_only=True)
            return tensors
    except OSError as error:
        raise ArtifactError(f"cannot read {path}: {error.strerror}") from None
