"""Latent codes of frames: what a network may know of one frame alone."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn


class FrameLatents(nn.Module):
    """A code a frame, nothing at first."""

    def __init__(self, frames: int, size: int) -> None:
        super().__init__()
        self.codes = nn.Parameter(torch.zeros(frames, size))

    def forward(self, frame: int) -> Float[Tensor, " Z"]:
        """A frame's; frames after the last have its code."""
        return self.codes[min(frame, len(self.codes) - 1)]

    def fill_untrained(self, trained: Sequence[int]) -> None:
        """Give each frame that was never trained the code of the nearest one that was."""
        known = torch.tensor(sorted(trained), device=self.codes.device)
        apart = torch.arange(len(self.codes), device=self.codes.device)[:, None] - known
        with torch.no_grad():
            self.codes.copy_(self.codes[known[apart.abs().argmin(1)]])
