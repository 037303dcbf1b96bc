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
from deblur_avatar.avatars.avatar import AvatarModel, FrameState, Rendering, TrainingStep
from deblur_avatar.avatars.half_precision import as_computed
from deblur_avatar.errors import ArtifactError
from deblur_avatar.motion.trajectory import Instants, Trajectory
from deblur_avatar.training.densify import Densifier, replace_gaussians
from deblur_avatar.training.exposure_gains import ExposureGains
from deblur_avatar.training.fusion_network import FusionNetwork
from deblur_avatar.training.growth import multiply_gaussians
from deblur_avatar.training.objective import Objective
from deblur_avatar.training.optimizers import Optimizers
from deblur_avatar.training.params import FitParams
from deblur_avatar.training.resume import (
    Progress,
    RunFolder,
    Snapshot,
)
from deblur_avatar.training.schedule import LevelParams
from deblur_avatar.training.supervision import (
    MASKS,
    SUPERVISIONS,
    Blend,
    Compared,
    Exposure,
    Mask,
    Supervision,
    still_frames,
)
from deblur_avatar.training.targets import Target, Targets, training_frames

Report = Callable[[int, Mapping[str, float]], None]

# Not a parameter: canonical positions move by less than their spacing in so many steps.
NEIGHBOUR_REFRESH = 100


class AvatarFit:
    """All unknowns, their optimizers, and one step of gradient descent.

    Args:
        avatar: on the device.
        trajectory: on the CPU, on any device: some hundred small numbers, each of whose many
            operations would wait for a GPU.
        observations: what the camera saw.
        params: how it is fitted.
        device: of what is made of Gaussians or pixels.
        generator: the CPU's, of all that is drawn.
        fusion: the network that blends renders, on the device, where they are blended.

    Raises:
        ArtifactError: if no training frame shows a person.
    """

    def __init__(
        self,
        avatar: AvatarModel,
        trajectory: Trajectory,
        observations: Observations,
        params: FitParams,
        device: torch.device,
        generator: torch.Generator,
        fusion: FusionNetwork | None = None,
    ) -> None:
        self.avatar, self.trajectory, self.fusion = avatar, trajectory, fusion
        self._params, self._scale = params, params.schedule.scale
        self._device, self._generator = device, generator
        self._observations = observations
        self._frames = training_frames(observations)
        self._level: LevelParams | None = None
        self._targets: Targets  # of the level
        recipe = params.recipe
        self.objective = Objective(avatar, trajectory, observations, recipe, params.motion, device)
        self._queue: list[int] = []
        self._still: set[int] | None = None
        self.optimizers = Optimizers(avatar, trajectory, fusion, params)
        densified = avatar.densified
        self._densifier = None if densified is None else Densifier(len(densified), device)
        self._gains = (
            ExposureGains(len(observations.frames), observations.averaging_space, device)
            if recipe.exposure_gain == "frame"
            else None
        )

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
                folder.save(iteration - 1, spent, self.optimizers.left_out, self._state())
            begin = time.perf_counter()
            report(iteration, self.step(iteration, supervision, mask))
            spent += time.perf_counter() - begin
            if folder is not None and folder.wants(iteration):
                folder.keep(iteration, spent, self._snapshot(iteration))
        self.avatar.fill_untrained_latents(self._frames)
        return spent

    def step(self, iteration: int, supervision: str, mask: str) -> dict[str, float]:
        """One iteration on one random frame."""
        chosen, covered = SUPERVISIONS[supervision], MASKS[mask]
        step = self._step(iteration)
        self._climb(iteration)
        self.optimizers.set_rates(iteration)
        if iteration % NEIGHBOUR_REFRESH == 0:
            self.avatar.invalidate_neighbours()
        index = self._next_frame()
        target = self._targets[index]
        instants = self.trajectory(index)
        exposure, state = self._render(index, instants, chosen, covered, step)
        compared = chosen.compared(
            exposure, self._blend(exposure, state), iteration / self._scale,
            lambda: self._is_still(index),
        )  # fmt: skip
        alpha = covered.of(exposure, chosen)
        terms = self.objective.pictures(self._with_gain(index, compared, target), alpha, target)
        terms |= self.objective.regularisers(exposure.instants, step)
        terms |= self.objective.priors(index, instants)
        names, values = _brought_together(terms, self._device)
        if self.optimizers.step(step, values.sum()):
            self.trajectory.keep_possible()
            self._densify(step, exposure.instants)
        return dict(zip(names, values.tolist(), strict=True))

    def cost(self, seconds: float) -> dict[str, Any]:
        """What a stage's measurements say of it, and which perceptual term it had."""
        return {
            "seconds": seconds,
            "gaussians": self._gaussians,
            "left_out": self.optimizers.left_out,
            "perceptual": self.objective.perceptual,
            **as_computed(self.avatar.precision, self._device),
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
        held = len(checkpoint.tensors.get("densifier.pull", ()))
        wanted = self._gaussians
        if held != wanted:
            raise ArtifactError(
                f"checkpoint/1 remembers {held} Gaussians, the avatar has {wanted}: "
                "take both from one run of one stage"
            )
        self._recall(checkpoint.tensors)

    @property
    def _gaussians(self) -> int:
        return 0 if self.avatar.densified is None else len(self.avatar.densified)

    def _climb(self, iteration: int) -> None:
        """Go on to the level that an iteration belongs to."""
        schedule = self._params.schedule
        level = schedule.level_at(iteration)
        if level is self._level:
            return
        self._level = level
        self._targets = Targets(self._observations, level.size, self._device)
        self.trajectory.limit_samples(level.virtual_poses)
        if schedule.grows_at(iteration) and self.avatar.densified is not None:
            assert self.optimizers.gaussians is not None
            gaussians, count = self.avatar.densified, schedule.gaussians_of(level)
            multiply_gaussians(gaussians, self.optimizers.gaussians, count, self._generator)
            self._densifier = Densifier(len(gaussians), self._device)
            self.avatar.invalidate_neighbours()

    def _memory(self) -> dict[str, Tensor]:
        parts = {"densifier": self._densifier, "gains": self._gains}
        held = {
            f"{name}.{key}": value.cpu().clone()
            for name, part in parts.items()
            if part is not None
            for key, value in part.state().items()
        }
        return self.optimizers.memory() | held

    def _recall(self, tensors: dict[str, Tensor]) -> None:
        self.optimizers.recall(tensors)
        if self._densifier is not None:
            self._densifier.restore(_below("densifier.", tensors))
        if self._gains is not None:
            self._gains.restore(_below("gains.", tensors))

    def _modules(self) -> dict[str, torch.nn.Module]:
        modules = {"model.": self.avatar, "trajectory.": self.trajectory}
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
        gaussians, optimizer = self.avatar.densified, self.optimizers.gaussians
        if gaussians is not None and optimizer is not None:
            none = torch.zeros(len(gaussians), dtype=torch.bool, device=self._device)
            replace_gaussians(gaussians, optimizer, none, [_below("model.gaussians.", tensors)])
        for prefix, module in self._modules().items():
            module.load_state_dict(_below(prefix, tensors))
        self._recall(tensors)
        self.optimizers.left_out = progress.left_out
        self._queue = tensors["frames_to_come"].tolist()
        self._generator.set_state(tensors["generator"])
        if "still_frames" in tensors:
            self._still = set(tensors["still_frames"].tolist())
        self.avatar.invalidate_neighbours()

    def _snapshot(self, iteration: int) -> Snapshot:
        avatar = copy.deepcopy(self.avatar)  # what is lent, and what is looked up, is its own
        avatar.fill_untrained_latents(self._frames)
        motion = self.trajectory.to_artifact(avatar.betas, self._observations.timestamps)
        return Snapshot(avatar=avatar.to_artifact(iteration), motion=motion)

    def _step(self, iteration: int) -> TrainingStep:
        return TrainingStep(iteration, self._scale, self._params.recipe.fitting, self._generator)

    def _render(
        self, index: int, instants: Instants, supervision: Supervision, mask: Mask,
        step: TrainingStep,
    ) -> tuple[Exposure, FrameState]:  # fmt: skip
        """Render what is compared of an exposure, conditioned for its middle."""
        camera = self._targets.camera
        # Asked for twice: the order of operations is that in which gradients are added.
        centre = instants.centre_rotations.to(self._device)
        rotations, transl = instants.centre_rotations[None], instants.centre_transl[None]
        if supervision.averages:  # the middle comes last
            rotations = torch.cat([instants.rotations, rotations])
            transl = torch.cat([instants.transl, transl])
        transforms = self.avatar.transforms(rotations, transl)
        state = self.avatar.condition(centre, index, transforms[-1], camera.viewmat, step)
        shown = transforms[:-1] if supervision.averages else transforms
        average = not mask.each
        if supervision.averages and (supervision.needs_sharp or mask.needs_sharp):
            both = self.avatar.render_exposure(state, transforms, camera, average=average)
            return Exposure(*both), state
        rendering = self.avatar.render(state, shown, camera, average=average)
        return Exposure(rendering, None), state

    def _blend(self, exposure: Exposure, state: FrameState) -> Blend | None:
        """The fusion network's choice between the sharp and the averaged render."""
        fusion = self.fusion
        if fusion is None:
            return None
        covered = (exposure.instants.alpha > 0).any(0) | (exposure.middle.alpha[0] > 0)
        code = state.pose_code if fusion.sees_pose else None
        return lambda seen: fusion(seen, covered, code, state.frame)

    def _with_gain(self, index: int, compared: list[Compared], target: Target) -> list[Compared]:
        """As bright as the frame is."""
        if self._gains is None:
            return compared
        gain = self._gains.of(index)
        last = compared[-1]
        self._gains.observe(index, target.behind(last.image, last.alpha), target)
        return [render._replace(image=gain * render.image) for render in compared]

    def _is_still(self, index: int) -> bool:
        """Whether a frame counts as still, which is settled once, when it first matters."""
        if self._still is None:
            self._still = still_frames(self.trajectory, self._frames)
        return index in self._still

    def _densify(self, step: TrainingStep, rendering: Rendering) -> None:
        """Add and drop Gaussians, of avatars that are made of them."""
        gaussians, rasterized = self.avatar.densified, rendering.rasterization
        if gaussians is None or self._densifier is None or rasterized is None:
            return
        if not rasterized.screen.filled:  # no loss looked at these renders
            return
        params = step.fitting.densify
        if not (step.past(params.start) and step.iteration < params.stop * step.scale):
            return
        camera = self._targets.camera
        screen = rasterized.screen
        size = (camera.width, camera.height)
        self._densifier.observe(screen.means2d_grad, rasterized.radii, *size)
        if step.iteration % max(round(params.every * step.scale), 1) == 0:
            assert self.optimizers.gaussians is not None
            self._densifier.edit(
                gaussians, self.optimizers.gaussians, params, self._generator, self.avatar.edits
            )
            self.avatar.invalidate_neighbours()

    def _next_frame(self) -> int:
        if not self._queue:
            frames = self._frames
            order = torch.randperm(len(frames), generator=self._generator).tolist()
            self._queue = [frames[position] for position in order]
        return self._queue.pop()


def _brought_together(
    terms: Mapping[str, Tensor], device: torch.device
) -> tuple[list[str], Float[Tensor, " terms"]]:
    """Terms of wherever they were found on one device; those of another in one transfer."""
    places = dict.fromkeys(term.device.type for term in terms.values())
    groups = [
        {name: term for name, term in terms.items() if term.device.type == place}
        for place in places
    ]
    values = [torch.stack(list(group.values())).to(device) for group in groups]
    return [name for group in groups for name in group], torch.cat(values)


def _below(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    found = tensors.items()
    return {key.removeprefix(prefix): value for key, value in found if key.startswith(prefix)}
