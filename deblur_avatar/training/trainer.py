"""The optimisation of an avatar and its motion against one camera's frames.

Conventions. Iterations count from 1 over all three stages of a run. Settings that say when
something starts count in the paper's 15,000 iterations and are scaled to the schedule.
"""

import copy
import time
from collections.abc import Callable, Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.half_precision import as_computed
from deblur_avatar.avatars.model import AvatarModel, FrameState
from deblur_avatar.errors import ArtifactError
from deblur_avatar.motion.trajectory import Instants, Trajectory
from deblur_avatar.rendering.rasterize import rasterize
from deblur_avatar.rendering.result import Rasterization
from deblur_avatar.training.densify import Densifier, replace_gaussians
from deblur_avatar.training.exposure_gains import ExposureGains
from deblur_avatar.training.fusion_network import FusionNetwork
from deblur_avatar.training.objective import Objective
from deblur_avatar.training.optimizers import PAPER_ITERATIONS, Descent
from deblur_avatar.training.params import StartParams
from deblur_avatar.training.resume import (
    Progress,
    RunFolder,
    Snapshot,
)
from deblur_avatar.training.schedule import ScheduleParams
from deblur_avatar.training.supervision import (
    BOTH_UNTIL,
    RELEASED,
    shares,
    still_frames,
)
from deblur_avatar.training.targets import Target, target_of

Report = Callable[[int, Mapping[str, float]], None]
Posed = tuple[Tensor, Tensor]  # means [S, N, 3] and covariances [S, N, 6] at S instants

NEIGHBOUR_REFRESH = 100  # steps; canonical positions move by less than their spacing in between
PRETRAIN_SAMPLES = 4096
PRETRAIN_RATE = 2e-3
POSE_NOISE_SHARE = 0.5  # of the steps have noise on the conditioning pose (3DGS-Avatar)


class AvatarFit:
    """All unknowns, their optimisers, and one step of gradient descent.

    Raises:
        ArtifactError: if no training frame shows a person.
    """

    def __init__(
        self,
        model: AvatarModel,
        trajectory: Trajectory,
        observations: Observations,
        params: StartParams,
        schedule: ScheduleParams,
        device: torch.device,
        generator: torch.Generator,
        fusion: FusionNetwork | None = None,
    ) -> None:
        self.model, self.trajectory, self.fusion = model, trajectory, fusion
        self._params, self._schedule = params, schedule
        self._device, self._generator = device, generator
        self._scale = schedule.fusion / PAPER_ITERATIONS
        camera = observations.train_camera
        self._K = observations.cameras.Ks[camera].to(device)
        self._viewmat = observations.cameras.viewmats[camera].to(device)
        self._timestamps = observations.timestamps
        self._targets = {
            index: target_of(observations, index, device)
            for index in observations.train
            if observations.weights[index] > 0
        }
        if not self._targets:
            raise ArtifactError("no training frame shows a person; check masks and weights")
        self.objective = Objective(
            model, trajectory, observations, params, self._scale, device, generator
        )
        self._queue: list[int] = []
        self._still: set[int] | None = None
        self.descent = Descent(model, trajectory, fusion, params, schedule)
        self._densifier = Densifier(len(model.gaussians), device)
        self._gains = (
            ExposureGains(len(observations.frames), observations.light, device)
            if params.exposure_gain == "frame"
            else None
        )

    def pretrain_skinning(self, iterations: int) -> None:
        """Teach the skinning network the body's own weights before it has to bend anything.

        In the paper's 3,000 steps of warm-up it learns them on the way; a short schedule cannot
        wait for that.
        """
        if self._params.model.skinning is None:
            return
        optimiser = torch.optim.Adam(self.model.skinning.parameters(), lr=PRETRAIN_RATE)
        decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(iterations, 1))
        for _ in range(iterations):
            optimiser.zero_grad()
            self.objective.skinning_apart(PRETRAIN_SAMPLES).backward()
            optimiser.step()
            decay.step()

    def run(
        self,
        first: int,
        last: int,
        supervision: str,
        mask: str,
        report: Report,
        folder: RunFolder | None = None,
        spent: float = 0.0,
    ) -> float:
        """Optimise from iteration `first` to `last` inclusive; returns seconds spent.

        Args:
            first: first iteration.
            last: last iteration.
            supervision: what frames are compared with: the sharp render, the mean over the
                virtual instants, the fusion network's blend of the two, or all of them as in the
                released code.
            mask: which coverage is compared with the matte: mean, union or centre.
            report: called after every iteration with its losses.
            folder: where to go on from, to save to now and then, and to keep snapshots in. What
                that takes is not counted.
            spent: seconds before the first iteration, to be counted too.

        Raises:
            FittingError: if too many steps had to be left out because of their numbers.
        """
        if folder is not None and folder.progress is not None:
            self._go_on(folder.progress)
            first, spent = folder.progress.iteration + 1, folder.progress.seconds
        for iteration in range(first, last + 1):
            # What is looked up is looked up anew in such a step, so that it need not be saved.
            if folder is not None and iteration % NEIGHBOUR_REFRESH == 0 and folder.due():
                folder.save(iteration - 1, spent, self.descent.left_out, self._state())
            begin = time.perf_counter()
            report(iteration, self.step(iteration, supervision, mask))
            spent += time.perf_counter() - begin
            if folder is not None and folder.wants(iteration):
                folder.keep(iteration, spent, self._snapshot(iteration))
        if self._params.model.color is not None:
            self.model.color.fill_untrained_latents(list(self._targets))
        return spent

    def step(self, iteration: int, supervision: str, mask: str) -> dict[str, float]:
        """One iteration on one random frame."""
        self.descent.set_rates(iteration)
        if iteration % NEIGHBOUR_REFRESH == 0:
            self._invalidate_neighbours()
        index = self._next_frame()
        target = self._targets[index]
        instants = self.trajectory(index)
        frame_state = self._condition(iteration, index, instants)
        both = supervision in ("fused", RELEASED) or mask == "centre"
        transforms = self._transforms(instants, supervision)
        noise = self.model.view_noise(self._generator)
        colors = self.model.colors(frame_state, transforms[-1], self._viewmat, noise)
        (means, covars), *centre = _posed(frame_state, transforms, both)
        drawn = self._rasterize(means, covars, colors, target, average=mask != "union")
        pictures = {"sharp" if supervision == "sharp" else "mean": drawn.image.mean(0)}
        covers = drawn.alpha
        if both:
            sharp = self._rasterize(*centre[0], colors, target, average=False)
            pictures["sharp"] = sharp.image[0]
            if supervision == RELEASED:
                # The sharp render is one more instant of the exposure, and of its coverage.
                pictures["mean"] = torch.lerp(
                    pictures["mean"], sharp.image[0], 1 / (len(means) + 1)
                )
                covers = torch.cat([covers, sharp.alpha])
            if mask == "centre":
                covers = sharp.alpha
            if self.fusion is not None:
                covered = (drawn.alpha > 0).any(0) | (sharp.alpha[0] > 0)
                pictures["fused"] = self._fused(pictures, covered, frame_state, supervision)
        alpha = 1 - (1 - covers).prod(0) if mask == "union" else covers.mean(0)
        still = supervision == RELEASED and self._is_still(iteration, index)
        blended = self.fusion is not None
        weights = shares(supervision, iteration / self._scale, still, blended)
        compared = [(weight, pictures[name]) for name, weight in weights.items()]
        if self._gains is not None:
            gain = self._gains.of(index)
            self._gains.observe(index, compared[-1][1], target)
            compared = [(weight, gain * picture) for weight, picture in compared]
        terms = self.objective.pictures(compared, alpha, target)
        terms |= self.objective.skinning(iteration)
        middle = len(means) // 2
        terms |= self.objective.isometry(means[middle], covars[middle])
        terms |= self.objective.evenness() | self.objective.priors(index, instants)
        total = torch.stack(list(terms.values())).sum()
        if self.descent.step(iteration, total):
            self._densify(iteration, drawn, target)
        return {name: float(value.detach()) for name, value in terms.items()}

    def cost(self, seconds: float) -> dict[str, Any]:
        """What a stage's measurements say of it, and which perceptual term it had."""
        return {
            "seconds": seconds,
            "gaussians": len(self.model.gaussians),
            "left_out": self.descent.left_out,
            "perceptual": self.objective.perceptual,
            **as_computed(self._params.model.precision, self._device),
        }

    def checkpoint(self, iteration: int) -> Checkpoint:
        """What the next stage needs to go on as if nothing had happened.

        Not the order of frames and the random draws: each stage has its own.
        """
        return Checkpoint(iteration=iteration, tensors=self._memory())

    def restore(self, checkpoint: Checkpoint) -> None:
        """Take over an earlier stage's memory; unknowns that are new start without any.

        Raises:
            ArtifactError: if it remembers another number of Gaussians than there are.
        """
        held, wanted = len(checkpoint.tensors["densifier.pull"]), len(self.model.gaussians)
        if held != wanted:
            raise ArtifactError(
                f"checkpoint/1 remembers {held} Gaussians, the avatar has {wanted}: "
                "take both from one run of one stage"
            )
        self._recall(checkpoint.tensors)

    def _memory(self) -> dict[str, Tensor]:
        held = {f"densifier.{key}": value for key, value in self._densifier.state().items()}
        if self._gains is not None:
            held |= {f"gains.{key}": value for key, value in self._gains.state().items()}
        return self.descent.memory() | {key: value.cpu().clone() for key, value in held.items()}

    def _recall(self, tensors: dict[str, Tensor]) -> None:
        self.descent.recall(tensors)
        self._densifier.restore(_below("densifier.", tensors))
        if self._gains is not None:
            self._gains.restore(_below("gains.", tensors))

    def _modules(self) -> dict[str, torch.nn.Module]:
        modules = {"model.": self.model, "trajectory.": self.trajectory}
        return modules if self.fusion is None else modules | {"fusion.": self.fusion}

    def _state(self) -> dict[str, Tensor]:
        """All that the next step depends on, except for what it looks up anew."""
        tensors = self._memory()
        for prefix, module in self._modules().items():
            tensors |= {prefix + key: value.cpu() for key, value in module.state_dict().items()}
        tensors["frames_to_come"] = torch.tensor(self._queue, dtype=torch.long)
        tensors["generator"] = self._generator.get_state()
        if self._still is not None:
            tensors["still_frames"] = torch.tensor(sorted(self._still), dtype=torch.long)
        return tensors

    def _go_on(self, progress: Progress) -> None:
        """Become the fit that `_state` described."""
        tensors = progress.tensors
        gaussians = self.model.gaussians
        none = torch.zeros(len(gaussians), dtype=torch.bool, device=self._device)
        replace_gaussians(
            gaussians, self.descent.gaussians, none, [_below("model.gaussians.", tensors)]
        )
        for prefix, module in self._modules().items():
            module.load_state_dict(_below(prefix, tensors))
        self._recall(tensors)
        self.descent.left_out = progress.left_out
        self._queue = tensors["frames_to_come"].tolist()
        self._generator.set_state(tensors["generator"])
        if "still_frames" in tensors:
            self._still = set(tensors["still_frames"].tolist())
        self._invalidate_neighbours()

    def _snapshot(self, iteration: int) -> Snapshot:
        model = copy.deepcopy(self.model)  # what is lent, and what is looked up, is its own
        if self._params.model.color is not None:
            model.color.fill_untrained_latents(list(self._targets))
        motion = self.trajectory.to_artifact(model.betas, self._timestamps)
        return Snapshot(avatar=model.to_artifact(iteration), motion=motion)

    def _condition(self, iteration: int, index: int, instants: Instants) -> FrameState:
        noise = None
        std = self._params.optimiser.pose_noise
        if std > 0 and self._params.model.nonrigid is not None:
            chance = torch.rand(1, generator=self._generator, device=self._device)
            draw = torch.randn(
                instants.centre_rotations.shape, generator=self._generator, device=self._device
            )
            noise = draw * std * (chance < POSE_NOISE_SHARE)
        deform = iteration > self._params.optimiser.nonrigid_start * self._scale
        return self.model.condition(
            instants.centre_rotations, index, deform=deform, pose_noise=noise
        )

    def _transforms(self, instants: Instants, supervision: str) -> Float[Tensor, "S J 4 4"]:
        """Of the drawn instants and, last, of the middle, in one go; if it is drawn alone, once."""
        rotations, transl = instants.centre_rotations[None], instants.centre_transl[None]
        if supervision != "sharp":
            rotations = torch.cat([instants.rotations, rotations])
            transl = torch.cat([instants.transl, transl])
        return self.model.transforms(rotations, transl)

    def _fused(
        self,
        pictures: dict[str, Tensor],
        covered: Tensor,
        frame_state: FrameState,
        supervision: str,
    ) -> Tensor:
        """The fusion network's blend of the sharp and the averaged render."""
        assert self.fusion is not None
        sharp, mean = pictures["sharp"], pictures["mean"]
        seen = sharp
        if supervision == RELEASED:
            seen = mean = mean.detach()
        code = frame_state.pose_code if self.fusion.sees_pose else None
        blend = self.fusion(seen, covered, code, frame_state.frame)
        return torch.lerp(sharp, mean, blend)

    def _is_still(self, iteration: int, index: int) -> bool:
        """Whether a frame counts as still, which is settled once, when it first matters."""
        if iteration < BOTH_UNTIL * self._scale:
            return False
        if self._still is None:
            self._still = still_frames(self.trajectory, list(self._targets))
        return index in self._still

    def _rasterize(
        self, means: Tensor, covars: Tensor, colors: Tensor, target: Target, average: bool
    ) -> Rasterization:
        height, width = target.matte.shape
        return rasterize(
            means, covars, self.model.gaussians.opacities, colors, self._viewmat, self._K,
            width, height, average=average,
        )  # fmt: skip

    def _densify(self, iteration: int, drawn: Rasterization, target: Target) -> None:
        params = self._params.densify
        if not params.start * self._scale < iteration < params.stop * self._scale:
            return
        height, width = target.matte.shape
        self._densifier.observe(drawn.screen.means2d_grad, drawn.radii, width, height)
        if iteration % max(round(params.every * self._scale), 1) == 0:
            self._densifier.edit(
                self.model.gaussians, self.descent.gaussians, params, self._generator
            )
            self._invalidate_neighbours()

    def _invalidate_neighbours(self) -> None:
        """Forget who is next to whom and where on the body, because Gaussians have moved."""
        self.objective.invalidate_neighbours()
        self.model.invalidate_neighbours()

    def _next_frame(self) -> int:
        if not self._queue:
            frames = list(self._targets)
            order = torch.randperm(
                len(frames), generator=self._generator, device=self._device
            ).tolist()
            self._queue = [frames[position] for position in order]
        return self._queue.pop()


def _posed(
    frame_state: FrameState, transforms: Float[Tensor, "S J 4 4"], both: bool
) -> list[Posed]:
    """The Gaussians at the drawn instants and, if `both` are wanted, in the middle.

    All in one call, which blends each Gaussian's transforms, and their gradients, only once.
    """
    if len(transforms) == 1:
        return [frame_state.posed(transforms)] * (2 if both else 1)
    if not both:
        return [frame_state.posed(transforms[:-1])]
    sizes = [len(transforms) - 1, 1]
    means, covars = (part.split(sizes) for part in frame_state.posed(transforms))
    return list(zip(means, covars, strict=True))


def _below(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    found = tensors.items()
    return {key.removeprefix(prefix): value for key, value in found if key.startswith(prefix)}
