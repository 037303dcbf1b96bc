"""One fit of the suite: warm-up, trajectory and fusion in memory, with nothing saved."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.config.reading import load_params
from deblur_avatar.methods import MethodParams
from deblur_avatar.pipeline.fusion import fuse, new_network
from deblur_avatar.pipeline.trajectory import fit_trajectory
from deblur_avatar.pipeline.warmup import warm_up
from deblur_avatar.training.fusion_network import FusionNetwork
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.resume import RunFolder
from deblur_avatar.training.schedule import ScheduleParams

DEGENERATE_SCALE = 1e-12  # metres


@dataclass(frozen=True)
class Fitted:
    """What a fit leaves: avatar and motion, the estimated shutter, and the time it took.

    `blend` is the network that chose between sharp and averaged renders, where there was one.
    """

    avatar: Avatar
    motion: Motion
    shutter: float | None  # seconds; None where it was given
    shutter_std: float | None  # seconds
    seconds: float
    processor_s: float  # of all threads: unlike seconds, no business of what else runs
    blend: FusionNetwork | None


@dataclass(frozen=True)
class FitSetup:
    """What all fits of one method share.

    Attributes:
        plain: what an avatar without networks is made of.
        networks: what one with networks is made of; None for methods that are not asked to.
        method: what follows the warm-up.
        own_oracle: whether the method itself is fitted to the sharp frames, too.
        schedule: how long a fit is.
        draws: fits that are averaged where a severity says nothing else.
        validation_stride: as `preprocess` wants it.
        seed: that damage and fits draw from, alike for every method.
        device: to fit on.
    """

    plain: RecipeParams
    networks: RecipeParams | None
    method: MethodParams
    own_oracle: bool
    schedule: ScheduleParams
    draws: int
    validation_stride: int
    seed: int
    device: torch.device

    @classmethod
    def of(cls, method: str, params_file: Path, seed: int, device: torch.device) -> "FitSetup":
        """Read the setup of one method of the suite."""
        with_networks = load_params(params_file, "with_networks", tuple[str, ...])
        networks = load_params(params_file, "avatars.paper", RecipeParams)
        return cls(
            plain=load_params(params_file, "avatars.lean", RecipeParams),
            networks=networks if method in with_networks else None,
            method=load_params(params_file, f"methods.{method}", MethodParams),
            own_oracle=method in load_params(params_file, "own_oracles", tuple[str, ...]),
            schedule=load_params(params_file, "schedules.suite", ScheduleParams),
            draws=load_params(params_file, "draws", int),
            validation_stride=load_params(params_file, "validation_stride", int),
            seed=seed,
            device=device,
        )


class _LastState(RunFolder):
    """Holds the state of a running stage in memory: no artifact has the fusion network."""

    def __init__(self) -> None:
        self.progress = None
        self.tensors: dict[str, Tensor] = {}

    def due(self) -> bool:
        return True

    def save(
        self, iteration: int, seconds: float, left_out: int, tensors: dict[str, Tensor]
    ) -> None:
        self.tensors = tensors

    def wants(self, iteration: int) -> bool:
        return False


def fit_method(
    observations: Observations,
    setup: FitSetup,
    recipe: RecipeParams,
    *,
    draw: int = 0,
    degenerate: float = 0.0,
) -> Fitted:
    """Fit as the three stages do; every fit of the suite draws alike, so that they compare.

    Args:
        observations: blurred, or sharp with exact poses.
        setup: how and where.
        recipe: what the avatar is made of.
        draw: number of the fit, of several that differ in their draws only.
        degenerate: share of the Gaussians that become extremely thin after the warm-up, and as
            many that become points.

    Raises:
        ConfigError, ArtifactError: as the stages do.
    """
    method, schedule, device = setup.method, setup.schedule, setup.device
    drawn = run.derive_seed(setup.seed + draw, "stability")
    torch.manual_seed(drawn)  # third parties draw from it
    generator = torch.Generator().manual_seed(drawn)
    begin, worked = time.perf_counter(), time.process_time()
    avatar, checkpoint, _ = warm_up(
        observations, recipe, schedule, device=device, generator=generator, report=_silence
    )
    if degenerate > 0:
        avatar = _with_degenerate_gaussians(avatar, degenerate)
    avatar, motion, checkpoint, cost = fit_trajectory(
        observations, avatar, checkpoint, recipe, method.trajectory, schedule,
        device=device, generator=generator, report=_silence,
    )  # fmt: skip
    shutter, std = motion.shutter, cost.get("shutter_std_s")
    state = _LastState()
    avatar, motion, _ = fuse(
        observations, avatar, motion, checkpoint, recipe, method.trajectory.motion,
        method.fusion, schedule, device=device, generator=generator, report=_silence, folder=state,
    )  # fmt: skip
    seconds, processor_s = time.perf_counter() - begin, time.process_time() - worked
    blend = _blend(observations, avatar, method, state, device)
    return Fitted(avatar, motion, shutter, std, seconds, processor_s, blend)


def _blend(
    observations: Observations,
    avatar: Avatar,
    method: MethodParams,
    state: _LastState,
    device: torch.device,
) -> FusionNetwork | None:
    """The fusion network as the last stage left it; None without one, or in a very short stage."""
    model = avatar_from_artifact(avatar, observations.body, device)
    network = new_network(method.fusion, model, len(observations.frames))
    prefix = "fusion."
    own = {k.removeprefix(prefix): v for k, v in state.tensors.items() if k.startswith(prefix)}
    if network is None or not own:
        return None
    network.load_state_dict(own)
    return network.to(device)


def lengthened(schedule: ScheduleParams, times: float) -> ScheduleParams:
    """The same schedule with so many times its iterations."""
    ends = {
        name: round(times * getattr(schedule, name)) for name in ("warmup", "trajectory", "fusion")
    }
    return schedule.model_copy(update=ends)


def _with_degenerate_gaussians(avatar: Avatar, share: float) -> Avatar:
    log_scales = avatar.log_scales.clone()
    count = round(share * len(log_scales))
    log_scales[:count, 0] = math.log(DEGENERATE_SCALE)
    log_scales[count : 2 * count] = math.log(DEGENERATE_SCALE)
    return replace(avatar, log_scales=log_scales)


def _silence(iteration: int, losses: Mapping[str, float]) -> None:
    pass
