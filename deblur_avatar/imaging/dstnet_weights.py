"""Weights of `dstnet_small`, with what made them.

No pickle: an artifact (artifacts/storage.py). What it says it holds is compared with what such a
network has before anything of that size is made.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor

from deblur_avatar.artifacts.storage import Artifact
from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.dstnet import LARGEST, Dstnet, DstnetParams


@dataclass(frozen=True, kw_only=True)
class DstnetWeights(Artifact):
    """A trained network: its sizes, its numbers, and the recipe. Made by `dstnet`."""

    schema: ClassVar[str] = "dstnet/1"

    features: int
    blocks: int
    refinements: int
    recipe: str  # JSON: the parameters of training and its seed
    clips: str  # SHA-256 of what it was trained on, hexadecimal
    tensors: dict[str, Tensor]

    def validate(self) -> None:
        """Refuse sizes that no network has, and numbers that are not those of one of these sizes.

        Raises:
            ValueError: naming what differs first.
        """
        for name in ("features", "blocks", "refinements"):
            if not 1 <= getattr(self, name) <= LARGEST:
                raise ValueError(f"{name} is {getattr(self, name)}, wanted 1 to {LARGEST}")
        with torch.device("meta"):  # shapes alone
            wanted = Dstnet(self.sizes).state_dict()
        _check_same(self.tensors, wanted)

    @property
    def sizes(self) -> DstnetParams:
        """Of the network."""
        return DstnetParams(
            features=self.features, blocks=self.blocks, refinements=self.refinements
        )

    def network(self) -> Dstnet:
        """The network, ready to `restore`."""
        network = Dstnet(self.sizes)
        network.load_state_dict(self.tensors)
        return network.eval().requires_grad_(False)


def load_dstnet(folder: Path, where: str) -> Dstnet:
    """Read a trained network.

    Args:
        folder: of an artifact.
        where: the parameter that named it, for errors.

    Raises:
        ArtifactError: if there is none, or it is damaged or of another network.
    """
    try:
        return DstnetWeights.load(folder).network()
    except ArtifactError as error:
        raise ArtifactError(
            f"{where}: no weights of this network: {error}; name a folder that the stage `dstnet` "
            "wrote (experiments/dstnet), or leave it empty for those that are shipped"
        ) from error


def _check_same(found: Mapping[str, Tensor], wanted: Mapping[str, Tensor]) -> None:
    for name in sorted(found.keys() ^ wanted.keys()):
        said = "are without" if name in wanted else "must not have"
        raise ValueError(f"tensors {said} {name!r:.80}, for a network of the sizes said")
    for name, tensor in found.items():
        same = tensor.shape == wanted[name].shape and tensor.dtype == wanted[name].dtype
        if not same:
            raise ValueError(
                f"tensors: {name} is {tensor.dtype} {tuple(tensor.shape)}, wanted "
                f"{wanted[name].dtype} {tuple(wanted[name].shape)}"
            )
