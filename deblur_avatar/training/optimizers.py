"""Optimizers: which of them moves which unknown, how fast, and when none may.

Conventions. Iterations count from 1 over all three stages of a run. A step whose loss or gradient
is not finite moves nothing and leaves the optimizers' memory as it was; the random draws that it
took stay taken.
"""

import logging
from collections import defaultdict
from collections.abc import Iterator, Mapping

import torch
from torch import Tensor

from deblur_avatar.avatars.avatar import AvatarModel, TrainingStep
from deblur_avatar.avatars.params import LearningRate
from deblur_avatar.errors import FittingError
from deblur_avatar.motion.trajectory import Trajectory
from deblur_avatar.training.fusion_network import FusionNetwork
from deblur_avatar.training.params import FitParams

logger = logging.getLogger(__name__)

# Not parameters: of the method's definition, and of what no good fit comes near to.
ADAM_EPSILON = 1e-15  # 3DGS: gradients of means are tiny
MAX_IN_A_ROW = 10  # steps that may be left out before fitting gives up
MAX_IN_ALL = 100  # of a whole stage


class Optimizers:
    """Adam of the Gaussians (whose number changes) and of all else: networks, motion, fusion."""

    def __init__(
        self,
        avatar: AvatarModel,
        trajectory: Trajectory,
        fusion: FusionNetwork | None,
        params: FitParams,
    ) -> None:
        rates = params.recipe.fitting.learning_rates(params.recipe.final_share)
        self.gaussians = _gaussian_optimizer(avatar, rates)
        self.others = _other_optimizer(avatar, trajectory, fusion, rates, params)
        self.left_out = 0
        self._in_a_row = 0
        self._fitting, self._schedule = params.recipe.fitting, params.schedule

    def set_rates(self, iteration: int) -> None:
        """Learning rates of one iteration."""
        for optimizer in self.all().values():
            for group in optimizer.param_groups:
                group["lr"] = group["rate"].at(iteration / self._schedule.fusion)
                if group["name"] == "means":
                    count = self._schedule.gaussians_of(self._schedule.level_at(iteration))
                    group["lr"] *= self._fitting.pace_of_means(count)

    def step(self, step: TrainingStep, total: Tensor) -> bool:
        """Move every unknown against its gradient; False if the step had to be left out.

        Raises:
            FittingError: naming the tensor, if too many steps had to be left out.
        """
        odd: str | None = "the loss"
        if bool(torch.isfinite(total)):
            # In this thread: another for a GPU's part costs more than it brings.
            with torch.autograd.set_multithreading_enabled(False):
                total.backward()
            odd = self._odd_gradient()
        if odd is None:
            self._move(step)
            self._in_a_row = 0
        else:
            self._leave_out(step.iteration, odd)
        for optimizer in self.all().values():
            optimizer.zero_grad()
        return odd is None

    def memory(self) -> dict[str, Tensor]:
        """What the optimizers remember, by unknown."""
        tensors: dict[str, Tensor] = {}
        for name, optimizer in self.all().items():
            for unknown, parameter in _named(optimizer):
                for key, value in optimizer.state.get(parameter, {}).items():
                    tensors[f"{name}.{unknown}.{key}"] = value.cpu().clone()
        return tensors

    def recall(self, tensors: dict[str, Tensor]) -> None:
        """Take over what `memory` gave; unknowns that are new, or of another shape, have none."""
        for name, optimizer in self.all().items():
            for unknown, parameter in _named(optimizer):
                prefix = f"{name}.{unknown}."
                memory = {
                    key.removeprefix(prefix): _laid_out_as(parameter, value)
                    for key, value in tensors.items()
                    if key.startswith(prefix)
                }
                if memory and memory["exp_avg"].shape == parameter.shape:
                    optimizer.state[parameter] = memory

    def all(self) -> dict[str, torch.optim.Optimizer]:
        """Those that have something to move, by their names on disk."""
        both = {"gaussians": self.gaussians, "networks": self.others}
        return {name: one for name, one in both.items() if one is not None}

    def _move(self, step: TrainingStep) -> None:
        if self.gaussians is not None and step.past(step.fitting.gaussians_start):
            self.gaussians.step()
        if self.others is None:
            return
        clipped = [
            parameter
            for group in self.others.param_groups
            for parameter in group["params"]
            if group["name"] == "network" and parameter.grad is not None
        ]
        if clipped and self._fitting.clip is not None:
            torch.nn.utils.clip_grad_norm_(clipped, self._fitting.clip)
        self.others.step()

    def _odd_gradient(self) -> str | None:
        """The name of an unknown whose gradient is not finite, or too large to be squared."""
        grads: dict[torch.device, dict[str, Tensor]] = defaultdict(dict)
        for optimizer in self.all().values():
            for name, parameter in _named(optimizer):
                if parameter.grad is not None:
                    grads[parameter.device][name] = parameter.grad
        names = [name for alike in grads.values() for name in alike]
        lengths = torch.cat(
            [torch.stack(torch._foreach_norm([*alike.values()])).cpu() for alike in grads.values()]
        )
        if bool(torch.isfinite(lengths.sum())):
            return None
        odd = (~torch.isfinite(lengths)).nonzero()
        return f"the gradient of {names[int(odd[0]) if len(odd) else int(lengths.argmax())]}"

    def _leave_out(self, iteration: int, odd: str) -> None:
        self.left_out += 1
        self._in_a_row += 1
        logger.warning("iteration %d is left out: %s is not finite", iteration, odd)
        if self._in_a_row > MAX_IN_A_ROW or self.left_out > MAX_IN_ALL:
            raise FittingError(
                f"iteration {iteration}: {odd} is not finite; {self.left_out} steps were left out, "
                f"{self._in_a_row} of them in a row. Look at the scene's check; lower the rates of "
                "`fitting` or the weights of `losses`"
            )


def _laid_out_as(parameter: Tensor, value: Tensor) -> Tensor:
    """A copy with the parameter's strides: the fused Adam goes through both in memory's order."""
    if value.shape != parameter.shape:
        return value.clone().to(parameter.device)
    return torch.empty_like(parameter, requires_grad=False).copy_(value)


def _named(optimizer: torch.optim.Optimizer) -> Iterator[tuple[str, Tensor]]:
    for group in optimizer.param_groups:
        yield from zip(group["names"], group["params"], strict=True)


def _own_groups(avatar: AvatarModel) -> set[str]:
    """Names of the groups that are the Gaussians' own."""
    own = avatar.densified
    parameters = set() if own is None else set(own.parameters())
    return {
        group
        for group, named in avatar.parameter_groups().items()
        if any(value in parameters for _, value in named)
    }


def _gaussian_optimizer(
    avatar: AvatarModel, rates: Mapping[str, LearningRate]
) -> torch.optim.Adam | None:
    """A group for each parameter of the Gaussians, so that densification can replace it."""
    groups = [
        {
            "params": [value for _, value in named], "names": [name for name, _ in named],
            "name": group, "rate": rates[group], "lr": rates[group].first,
        }
        for group, named in avatar.parameter_groups().items()
        if group in _own_groups(avatar)
    ]  # fmt: skip
    return torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True) if groups else None


def _other_optimizer(
    avatar: AvatarModel,
    trajectory: Trajectory,
    fusion: FusionNetwork | None,
    rates: Mapping[str, LearningRate],
    params: FitParams,
) -> torch.optim.Adam | None:
    """Networks, motion, fusion; what moves alike is one group, and its parameters have names.

    Each group is a call of its own, which takes longer than to move a small parameter.
    """
    alike: dict[tuple[str, LearningRate], dict[str, Tensor]] = defaultdict(dict)
    own = _own_groups(avatar)
    for group, named in avatar.parameter_groups().items():
        if group not in own:
            alike["network", rates[group]] |= {f"network.{name}": value for name, value in named}
    paces = {
        name: LearningRate(params.motion.learning_rates()[group], params.recipe.final_share)
        for group, named in trajectory.parameter_groups().items()
        for name, value in named
        if value.requires_grad
    }
    # In the module's order, whatever the groups': the optimizer's memory is kept in it.
    for name, value in trajectory.named_parameters():
        if value.requires_grad:
            alike["motion", paces[name]][f"motion.{name}"] = value
    if fusion is not None:
        assert params.fusion is not None
        alike["fusion", LearningRate(params.fusion.rate)] = {
            f"fusion.{name}": value for name, value in fusion.named_parameters()
        }
    groups = [
        {
            "params": list(named.values()), "names": list(named), "name": family, "rate": rate,
            "lr": rate.first, "weight_decay": rate.weight_decay,
        }
        for (family, rate), named in alike.items()
    ]  # fmt: skip
    return torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True) if groups else None
