"""Where Gaussians are added, and where they are taken away.

Conventions. Gradients of screen positions are in half image widths, so a threshold holds at any
resolution. A frame's virtual instants each carry 1 / S of the loss, so the sum of their gradients'
lengths is what one sharp instant would have; lengths are added, never vectors, because opposite
instants cancel.
"""

from collections.abc import Callable

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.optim import Optimizer

from deblur_avatar.avatars.gaussian_edits import Edits, Part, copied, halves, strongest
from deblur_avatar.avatars.gaussians import Gaussians
from deblur_avatar.avatars.params import DensifyParams

# An avatar's own rule: `AvatarModel.edits`.
Rule = Callable[[Tensor, DensifyParams, int, torch.Generator], Edits | None]


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
        rule: Rule | None = None,
    ) -> None:
        """Add and drop Gaussians by the avatar's own rule, if it has one, or by the usual one."""
        grad_accum = self.grad_accum / self.count.clamp(min=1)
        with torch.no_grad():
            room = max(int(params.max_growth * self._first_count) - len(gaussians), 0)
            own = None if rule is None else rule(grad_accum, params, room, generator)
            keep, added = own or _usual_edits(gaussians, grad_accum, params, room, generator)
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
    added: list[Part],
) -> None:
    """Keep some Gaussians, add others; the optimizer's memory follows (new ones have none)."""
    for group in optimizer.param_groups:
        (name,), (old,) = group["names"], group["params"]
        new = [part[name].to(old.device) for part in added]
        fresh = torch.nn.Parameter(torch.cat([old.data[keep], *new]))
        memory = optimizer.state.pop(old, {})
        for key, value in memory.items():
            if value.shape == old.shape:
                grown = [torch.zeros_like(part) for part in new]
                memory[key] = torch.cat([value[keep], *grown])
        optimizer.state[fresh] = memory
        group["params"] = [fresh]
        setattr(gaussians, name, fresh)


def _usual_edits(
    gaussians: Gaussians, pulls: Tensor, params: DensifyParams, room: int,
    generator: torch.Generator,
) -> Edits:  # fmt: skip
    """Clone small, split large Gaussians of large gradient; drop faint and huge ones."""
    largest = gaussians.scales.amax(1)
    moved = strongest(pulls, params.gradient, room)
    clone = moved & (largest <= params.clone_below_m)
    split = moved & ~clone
    faint = gaussians.opacities < params.prune_opacity
    keep = ~(split | faint | (largest > params.prune_scale_m))
    return keep, [copied(gaussians, clone), *halves(gaussians, split, generator)]
