"""One step down the gradient: which optimiser moves which unknown, how fast, and when none may.

Conventions. Iterations count from 1 over all three stages of a run. A step whose loss or gradient
is not finite moves nothing and leaves the optimisers' memory as it was; the random draws that it
took stay taken.
"""

import logging
from collections import defaultdict
from collections.abc import Iterator

import torch
from torch import Tensor

from deblur_avatar.avatars.model import AvatarModel
from deblur_avatar.errors import FittingError
from deblur_avatar.motion.trajectory import Trajectory
from deblur_avatar.training.fusion_network import FusionNetwork
from deblur_avatar.training.params import StartParams
from deblur_avatar.training.schedule import ScheduleParams

logger = logging.getLogger(__name__)

PAPER_ITERATIONS = 15_000  # arXiv 2501.13335, sec. IV-A
ADAM_EPSILON = 1e-15  # 3DGS: gradients of means are tiny
MAX_IN_A_ROW = 10  # steps that may be left out before fitting gives up
MAX_IN_ALL = 100


class Descent:
    """The optimisers of the Gaussians (rebuilt when their number changes) and of all else."""

    def __init__(
        self,
        model: AvatarModel,
        trajectory: Trajectory,
        fusion: FusionNetwork | None,
        params: StartParams,
        schedule: ScheduleParams,
    ) -> None:
        self.gaussians = _gaussian_optimiser(model, params)
        self.others = _other_optimiser(model, trajectory, fusion, params)
        self.left_out = 0
        self._in_a_row = 0
        self._params, self._last = params.optimiser, schedule.fusion
        self._rates = [group["lr"] for group in self.others.param_groups]

    def set_rates(self, iteration: int) -> None:
        """Learning rates of one iteration."""
        rates = self._params
        share = iteration / self._last
        for group in self.gaussians.param_groups:
            if group["name"] == "means":
                # Log-linear over twice the paper's run, as in the authors' code.
                group["lr"] = rates.means * (rates.means_final / rates.means) ** (share / 2)
        for group, rate in zip(self.others.param_groups, self._rates, strict=True):
            if group["name"] != "fusion":
                group["lr"] = rate * rates.final_share**share

    def step(self, iteration: int, total: Tensor) -> bool:
        """Move every unknown against its gradient; False if the step had to be left out.

        Raises:
            FittingError: naming the tensor, if too many steps had to be left out.
        """
        odd: str | None = "the loss"
        if bool(torch.isfinite(total)):
            total.backward()
            odd = self._odd_gradient()
        if odd is None:
            self._move(iteration)
            self._in_a_row = 0
        else:
            self._leave_out(iteration, odd)
        self.gaussians.zero_grad()
        self.others.zero_grad()
        return odd is None

    def memory(self) -> dict[str, Tensor]:
        """What the optimisers remember, by unknown."""
        tensors: dict[str, Tensor] = {}
        for name, optimiser in self.optimisers().items():
            for unknown, parameter in _named(optimiser):
                for key, value in optimiser.state.get(parameter, {}).items():
                    tensors[f"{name}.{unknown}.{key}"] = value.cpu().clone()
        return tensors

    def recall(self, tensors: dict[str, Tensor]) -> None:
        """Take over what `memory` gave; unknowns that are new, or of another shape, have none."""
        for name, optimiser in self.optimisers().items():
            for unknown, parameter in _named(optimiser):
                prefix = f"{name}.{unknown}."
                memory = {
                    key.removeprefix(prefix): value.clone().to(parameter.device)
                    for key, value in tensors.items()
                    if key.startswith(prefix)
                }
                if memory and memory["exp_avg"].shape == parameter.shape:
                    optimiser.state[parameter] = memory

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Both, by name."""
        return {"gaussians": self.gaussians, "networks": self.others}

    def _move(self, iteration: int) -> None:
        if iteration > self._params.gaussians_start * self._last / PAPER_ITERATIONS:
            self.gaussians.step()
        networks = [
            parameter
            for group in self.others.param_groups
            for parameter in group["params"]
            if group["name"] == "network" and parameter.grad is not None
        ]
        if networks:
            torch.nn.utils.clip_grad_norm_(networks, self._params.clip)
        self.others.step()

    def _odd_gradient(self) -> str | None:
        """The name of an unknown whose gradient is not finite, or too large to be squared."""
        named = [
            (name, parameter.grad)
            for optimiser in self.optimisers().values()
            for name, parameter in _named(optimiser)
            if parameter.grad is not None
        ]
        lengths = torch.stack(torch._foreach_norm([grad for _, grad in named]))
        if bool(torch.isfinite(lengths.sum())):
            return None
        odd = (~torch.isfinite(lengths)).nonzero()
        return f"the gradient of {named[int(odd[0]) if len(odd) else int(lengths.argmax())][0]}"

    def _leave_out(self, iteration: int, odd: str) -> None:
        self.left_out += 1
        self._in_a_row += 1
        logger.warning("iteration %d is left out: %s is not finite", iteration, odd)
        if self._in_a_row > MAX_IN_A_ROW or self.left_out > MAX_IN_ALL:
            raise FittingError(
                f"iteration {iteration}: {odd} is not finite; {self.left_out} steps were left out, "
                f"{self._in_a_row} of them in a row. Look at the scene's check; lower the rates of "
                "`optimiser` or the weights of `losses`"
            )


def _named(optimiser: torch.optim.Optimizer) -> Iterator[tuple[str, Tensor]]:
    for group in optimiser.param_groups:
        yield from zip(group["names"], group["params"], strict=True)


def _gaussian_optimiser(model: AvatarModel, params: StartParams) -> torch.optim.Adam:
    """A group each for means, quats, log_scales, opacities, features."""
    rates = params.optimiser
    chosen = {
        "means": rates.means,
        "quats": rates.quats,
        "log_scales": rates.scales,
        "opacity_logits": rates.opacities,
        "features": rates.features,
    }
    groups = [
        {"params": [value], "lr": chosen[name], "name": name, "names": [name]}
        for name, value in model.gaussians.named_parameters()
    ]
    return torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True)


def _other_optimiser(
    model: AvatarModel,
    trajectory: Trajectory,
    fusion: FusionNetwork | None,
    params: StartParams,
) -> torch.optim.Adam:
    """Networks, motion, fusion; what moves alike is one group, and its parameters have names.

    Each group is a call of its own, which takes longer than to move a small parameter.
    """
    rates = params.optimiser
    alike: dict[tuple[str, float, float], dict[str, Tensor]] = defaultdict(dict)
    for prefix, rate in (
        ("skinning", rates.rigid),
        ("nonrigid", rates.nonrigid),
        ("pose_encoder", rates.nonrigid),
        ("color", rates.color),
    ):
        for name, value in model.named_parameters():
            if name.startswith(f"{prefix}."):
                decay = rates.latent_decay if "latents" in name else 0.0
                alike["network", rate, decay][f"network.{name}"] = value
    of_group = {"poses": rates.poses, "transl": rates.transl, "shutter": rates.shutter}
    rate_of = {
        name: of_group[group]
        for group, named in trajectory.parameter_groups().items()
        for name, _ in named
    }
    # In the module's order, whatever the groups': the optimiser's memory is kept in it.
    for name, value in trajectory.named_parameters():
        if value.requires_grad:
            alike["motion", rate_of[name], 0.0][f"motion.{name}"] = value
    if fusion is not None:
        for name, value in fusion.named_parameters():
            alike["fusion", rates.fusion, 0.0][f"fusion.{name}"] = value
    if not alike:
        alike["nothing", 0.0, 0.0]["nothing"] = torch.nn.Parameter(torch.zeros(1))
    groups = [
        {
            "params": list(named.values()), "names": list(named), "name": kind,
            "lr": rate, "weight_decay": decay,
        }
        for (kind, rate, decay), named in alike.items()
    ]  # fmt: skip
    return torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True)
