"""Supervised training of a deblurring network on pieces of clips.

Conventions. A batch is [B, T, D, H, W] in [0, 1]: T frames next to each other of one person,
window and square, D = 4 layers (sRGB and the matte). What a step sees depends on the seed and the
step alone, so that training goes on where it was stopped as if it had not been.

Sources: Pan et al., "Deep discriminative spatial and temporal network for efficient video
deblurring", CVPR 2023, for loss, optimiser and mirroring; Loshchilov and Hutter, "SGDR", ICLR
2017, for the schedule.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Float, UInt8
from pydantic import Field, model_validator
from torch import Tensor

from deblur_avatar.artifacts.deblurring_clips import DeblurringClips
from deblur_avatar.config.section import Count, NonNegative, Params, Positive
from deblur_avatar.imaging.dstnet import MULTIPLE, Dstnet, DstnetParams
from deblur_avatar.run import derive_seed

SOFTNESS = 1e-6  # of Charbonnier's loss: the square root of the published 1e-12
STEEPEST = 1.0  # norm that gradients are cut to: fused features go through every frame


class DstnetTrainingParams(Params):
    """The network and how it is trained."""

    network: DstnetParams
    iterations: Count
    batch: Count
    frames: Count  # of a piece of a clip
    size: Annotated[int, Field(ge=MULTIPLE, multiple_of=MULTIPLE)]  # of a piece, pixels
    rate: Positive
    final_rate: Positive
    rise: Count  # iterations in which the rate rises to `rate`
    weight_decay: NonNegative
    frequencies: NonNegative  # weight of differences between Fourier transforms

    @model_validator(mode="after")
    def _check_rise(self) -> "DstnetTrainingParams":
        if self.rise >= self.iterations:
            raise ValueError(f"rise: wanted fewer than the {self.iterations} iterations")
        return self


@dataclass(frozen=True)
class Layers:
    """All training clips as layers."""

    sharp: UInt8[Tensor, "P F D H W"]
    blurred: UInt8[Tensor, "P L F D H W"]

    @classmethod
    def of(cls, clips: DeblurringClips) -> "Layers":
        """Colours and mattes together."""
        return cls(
            _layers(clips.sharp, clips.sharp_mattes), _layers(clips.blurred, clips.blurred_mattes)
        )


def rate_at(step: int, params: DstnetTrainingParams) -> float:
    """The learning rate of a step, from 0: up along a line, then down along a cosine."""
    if step < params.rise:
        return params.rate * (step + 1) / params.rise
    share = (step - params.rise) / max(params.iterations - params.rise - 1, 1)
    low = params.final_rate
    return low + (params.rate - low) * (1 + math.cos(math.pi * share)) / 2


def draw_batch(
    layers: Layers, params: DstnetTrainingParams, seed: int, step: int
) -> tuple[Float[Tensor, "B T D H W"], Float[Tensor, "B T D H W"]]:
    """Blurred pieces about persons, and the sharp ones; mirrored, turned over, in either direction
    of time, their colours exchanged at random.
    """
    generator = torch.Generator().manual_seed(derive_seed(seed, "dstnet", str(step)))
    pieces = [_draw_piece(layers, params, generator) for _ in range(params.batch)]
    blurred, sharp = (torch.stack(stacked) for stacked in zip(*pieces, strict=True))
    return blurred / 255, sharp / 255


def deblurring_loss(
    restored: Float[Tensor, "B T D H W"], sharp: Float[Tensor, "B T D H W"], frequencies: float
) -> Tensor:
    """Charbonnier's loss, and so many times the mean difference of Fourier coefficients."""
    away = restored - sharp
    loss = (away.square() + SOFTNESS**2).sqrt().mean()
    if frequencies > 0:
        spectrum = torch.view_as_real(torch.fft.rfft2(away))
        loss = loss + frequencies * spectrum.abs().mean()
    return loss


class DeblurringTrainer:
    """A network, its optimiser, and how many steps they have taken."""

    def __init__(self, params: DstnetTrainingParams, layers: Layers, seed: int) -> None:
        self.params, self.layers, self.seed = params, layers, seed
        torch.manual_seed(derive_seed(seed, "dstnet", "weights"))  # modules draw from it
        self.network = Dstnet(params.network)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), params.rate, weight_decay=params.weight_decay
        )
        self.done = 0

    def step(self) -> float:
        """Take one step; returns its loss."""
        blurred, sharp = draw_batch(self.layers, self.params, self.seed, self.done)
        for group in self.optimizer.param_groups:
            group["lr"] = rate_at(self.done, self.params)
        self.optimizer.zero_grad()
        loss = deblurring_loss(self.network(blurred), sharp, self.params.frequencies)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), STEEPEST)
        self.optimizer.step()
        self.done += 1
        return float(loss.detach())

    def state(self) -> dict[str, Tensor]:
        """All that one more step depends on, by name."""
        moments = {
            f"optimizer.{index}.{name}": value
            for index, entry in self.optimizer.state_dict()["state"].items()
            for name, value in entry.items()
        }
        weights = self.network.state_dict().items()
        return {**{f"network.{name}": value for name, value in weights}, **moments}

    def go_on(self, done: int, state: dict[str, Tensor]) -> None:
        """Take up what `state` said after `done` steps."""
        self.done = done
        network = {name: value for name, value in state.items() if name.startswith("network.")}
        self.network.load_state_dict(
            {name.removeprefix("network."): value for name, value in network.items()}
        )
        moments: dict[int, dict[str, Tensor]] = {}
        for name in state.keys() - network.keys():
            _, index, moment = name.split(".")
            moments.setdefault(int(index), {})[moment] = state[name]
        self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": moments})


def _draw_piece(
    layers: Layers, params: DstnetTrainingParams, generator: torch.Generator
) -> tuple[Float[Tensor, "T D H W"], Float[Tensor, "T D H W"]]:
    def below(count: int) -> int:
        return int(torch.randint(count, (1,), generator=generator))

    persons, windows, frames = layers.blurred.shape[:3]
    person, window = below(persons), below(windows)
    first = below(frames - params.frames + 1)
    shown = slice(first, first + params.frames)
    blurred, sharp = layers.blurred[person, window, shown], layers.sharp[person, shown]
    rows, columns = torch.nonzero(blurred[params.frames // 2, 3], as_tuple=True)
    pixel = below(len(rows)) if len(rows) else 0
    height, width = blurred.shape[-2:]
    middle = (int(rows[pixel]), int(columns[pixel])) if len(rows) else (height // 2, width // 2)
    top, left = (
        min(max(place - params.size // 2, 0), length - params.size)
        for place, length in zip(middle, (height, width), strict=True)
    )
    order = [*torch.randperm(3, generator=generator).tolist(), 3]
    turns = [axis for axis in (0, 2, 3) if below(2)]
    swap = below(2)

    def piece(clip: UInt8[Tensor, "T D H W"]) -> Float[Tensor, "N D S S"]:
        cut = clip[..., top : top + params.size, left : left + params.size]
        cut = cut[:, order].float().flip(turns)
        return cut.transpose(2, 3) if swap else cut

    return piece(blurred), piece(sharp)


def _layers(colours: Tensor, mattes: Tensor) -> Tensor:
    return torch.cat([colours, mattes[..., None]], -1).movedim(-1, -3)
