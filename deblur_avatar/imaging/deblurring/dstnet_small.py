"""The video deblurring network of our own size (imaging/dstnet.py), trained on nobody's scene.

Its weights lie beside this module; experiments/dstnet says how they were made.
"""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

from deblur_avatar.config.reading import expand_environment
from deblur_avatar.config.section import Count, Params
from deblur_avatar.imaging.deblurring.deblurrer import (
    Pictures,
    codes_of,
    person_box,
    values_of,
)
from deblur_avatar.imaging.dstnet import Dstnet, restore
from deblur_avatar.imaging.dstnet_weights import load_dstnet

SHIPPED = Path(__file__).with_name("dstnet_small")
# Named, so that other weights are other code to the stage that reads them (pipeline/code.py).
PARTS = ("manifest.json", "tensors.safetensors")


class DstnetSmallParams(Params):
    """A recurrent network over clips; colours and mattes go through it together."""

    kind: Literal["dstnet_small"]
    weights: str  # a folder that the stage `dstnet` wrote; empty for those that are shipped
    frames_at_once: Count  # of a clip; a longer one is cut, its last piece begins earlier

    def deblur(
        self, blurred: Pictures, averaging_space: str, clips: Sequence[slice]
    ) -> tuple[Pictures, dict[str, Any]]:
        """Sharpen each clip by itself; notes which weights did."""
        named = expand_environment(self.weights, "predeblur.deblurrer.weights")
        folder = Path(named) if named else SHIPPED
        network = load_dstnet(folder, "predeblur.deblurrer.weights")
        digest = hashlib.sha256(b"".join((folder / part).read_bytes() for part in PARTS))
        colours, coverage = blurred.frames.movedim(-1, 1), blurred.mattes[:, None]
        layers = torch.cat([colours, coverage], 1)
        made = layers.clone()
        for clip in clips:
            made[clip] = self._sharpened(network, layers[clip])
        pictures = Pictures(made[:, :3].movedim(1, -1).contiguous(), made[:, 3].contiguous())
        return pictures, {"weights": digest.hexdigest()}

    def _sharpened(self, network: Dstnet, layers: Tensor) -> Tensor:
        """One clip, changed near the person alone; codes."""
        whole = person_box(layers[:, 3].amax(0))
        made = layers.clone()
        if whole is None:
            return made
        values = values_of(layers[..., whole[0], whole[1]])
        restored = torch.empty_like(values)
        for piece in pieces(len(layers), self.frames_at_once):
            restored[piece] = restore(network, values[piece])
        codes = torch.zeros_like(layers)
        codes[..., whole[0], whole[1]] = codes_of(restored)
        for index, matte in enumerate(layers[:, 3]):
            box = person_box(matte)
            if box is not None:
                made[index][..., box[0], box[1]] = codes[index][..., box[0], box[1]]
        return made


def pieces(count: int, at_once: int) -> list[slice]:
    """Cut a clip into pieces of the same length, the last of which begins earlier; a shorter clip
    is one piece.
    """
    starts = [min(start, max(count - at_once, 0)) for start in range(0, count, at_once)]
    return [slice(start, min(start + at_once, count)) for start in starts]
