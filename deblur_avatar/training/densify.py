"""Where Gaussians are added, and where they are taken away.

Conventions. Gradients of screen positions are in half image widths, so a threshold holds at any
resolution. A frame's virtual instants each carry 1 / S of the loss, so the sum of their gradients'
lengths is what one sharp instant would have; lengths are added, never vectors, because opposite
instants cancel.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.optim import Optimizer

from deblur_avatar.avatars.gaussians import Gaussians
from deblur_avatar.avatars.params import DensifyParams
from deblur_avatar.geometry.rotations import quat_to_matrix

# Not a parameter: 3DGS's (Kerbl et al. 2023); which are split, DensifyParams' thresholds say.
SPLIT_SHRINK = 1.6  # how much narrower the two halves of a split Gaussian are


class Densifier:
    """Collects how strongly each Gaussian is moved, and edits the set by it.

    Source: Kerbl et al. 2023 sec. 5, with 3DGS-Avatar's thresholds. Without opacity resets, which
    under blur throw away what the average has already explained; and without the limit on the size
    in the image, which holds at one resolution only.
    """

    def __init__(self, count: int, device: torch.device) -> None:
        self._first_count = count
        self.grad_accum = torch.zeros(count, device=device)
        self.count = torch.zeros(count, device=device)

    def observe(
        self, gradients: Float[Tensor, "B N 2"], radii: Int[Tensor, "B N"], width: int, height: int
    ) -> None:
        """Add one step's screen gradients (per pixel of shift)."""
        half = gradients.new_tensor([width / 2, height / 2])
        self.grad_accum += (gradients * half).norm(dim=-1).sum(0)
        self.count += (radii > 0).any(0)

    def edit(
        self,
        gaussians: Gaussians,
        optimizer: Optimizer,
        params: DensifyParams,
        generator: torch.Generator,
    ) -> None:
        """Clone small, split large Gaussians of large gradient; drop faint and huge ones."""
        grad_accum = self.grad_accum / self.count.clamp(min=1)
        with torch.no_grad():
            largest = gaussians.scales.amax(1)
            room = int(params.max_growth * self._first_count) - len(gaussians)
            moved = _strongest(grad_accum, params.gradient, max(room, 0))
            clone = moved & (largest <= params.clone_below_m)
            split = moved & ~clone
            faint = gaussians.opacities < params.prune_opacity
            keep = ~(split | faint | (largest > params.prune_scale_m))
            added = [_cloned(gaussians, clone), *_halves(gaussians, split, generator)]
        replace_gaussians(gaussians, optimizer, keep, added)
        self.grad_accum = torch.zeros(len(gaussians), device=self.grad_accum.device)
        self.count = torch.zeros_like(self.grad_accum)

    def state(self) -> dict[str, Tensor]:
        """What must be kept to go on later."""
        first = torch.tensor([self._first_count])
        return {"pull": self.grad_accum, "visits": self.count, "first_count": first}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Go on from what `state` gave."""
        self.grad_accum = state["pull"].clone().to(self.grad_accum)
        self.count = state["visits"].clone().to(self.grad_accum)
        self._first_count = int(state["first_count"])


def replace_gaussians(
    gaussians: Gaussians,
    optimizer: Optimizer,
    keep: Tensor,
    added: list[dict[str, Tensor]],
) -> None:
    """Keep some Gaussians, add others; the optimizer's memory follows (new ones have none)."""
    for group in optimizer.param_groups:
        (name,), (old,) = group["names"], group["params"]
        new = [part[name] for part in added]
        fresh = torch.nn.Parameter(torch.cat([old.data[keep], *new]))
        memory = optimizer.state.pop(old, {})
        for key, value in memory.items():
            if value.shape == old.shape:
                grown = [torch.zeros_like(part) for part in new]
                memory[key] = torch.cat([value[keep], *grown])
        optimizer.state[fresh] = memory
        group["params"] = [fresh]
        setattr(gaussians, name, fresh)


def _strongest(grad_accum: Tensor, threshold: float, room: int) -> Tensor:
    chosen = grad_accum > threshold
    if int(chosen.sum()) > room:
        order = torch.where(chosen, grad_accum, torch.zeros_like(grad_accum)).argsort(
            descending=True
        )
        chosen = torch.zeros_like(chosen)
        chosen[order[:room]] = True
    return chosen


def _cloned(gaussians: Gaussians, chosen: Tensor) -> dict[str, Tensor]:
    return {name: value.data[chosen] for name, value in gaussians.named_parameters()}


def _halves(
    gaussians: Gaussians, chosen: Tensor, generator: torch.Generator
) -> list[dict[str, Tensor]]:
    parts = []
    for _ in range(2):
        part = _cloned(gaussians, chosen)
        scales = part["log_scales"].exp()
        offset = torch.randn(scales.shape, generator=generator, device=scales.device) * scales
        turned = (quat_to_matrix(part["quats"]) @ offset[..., None])[..., 0]
        part["means"] = part["means"] + turned
        part["log_scales"] = (scales / SPLIT_SHRINK).log()
        parts.append(part)
    return parts
