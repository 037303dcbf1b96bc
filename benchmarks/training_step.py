"""Training step benchmark: its time by part, and what sharing work between instants saves.

    python -m benchmarks.training_step [--json FILE]

prints JSON: for each method milliseconds a step (the median), milliseconds and shares of its parts
(forward and backward), shares of kinds of work, and for `paper` the same step written naively:
instants one by one, networks evaluated for each, coverage rendered apart. Both are measured in
turns of a few steps, so that a busy machine slows them alike. The scene is a person of capsules.
`--methods` names some of the methods; all of them take minutes.

Kinds of work: `rasterizer`, `posing kernel`, `covariance factors kernel`, `isometry kernel`,
`smoothness kernel`, `trajectory kernel` and `losses kernel` are native. `layers` is all inside a
stack of network layers, where products, ReLUs and rounding alternate. `matrix products` is what of
that, and of everything else but the kernels, are products in the narrow sense.
`rasterizer_and_products` is the share of the rasterizer, of posing, of covariance factors and of
products in the narrow sense:
posing and covariance factors are products of matrices, written as kernels; the others are none.

Shares are of the step as it runs without a profiler (benchmarks/step_profile.py); `recorded` says
the share with it, which is rather too low.
"""

import argparse
import math
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks.rasterizer import machine
from benchmarks.record import print_record
from benchmarks.step_profile import (
    TURN,
    WARM_UP,
    Step,
    mark,
    record,
    shares_of_parts,
    shares_of_work,
)
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.half_precision import as_computed
from deblur_avatar.avatars.kinds import AVATARS
from deblur_avatar.avatars.params import Precision
from deblur_avatar.avatars.plain_avatar import PlainAvatar, PlainParams
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.avatars.splats import SplatAvatar
from deblur_avatar.bodies.capsule import capsule_body
from deblur_avatar.config.reading import load_params
from deblur_avatar.geometry.cameras import look_at
from deblur_avatar.methods import MethodParams
from deblur_avatar.pipeline.fusion import FusedParams, network_params, new_network
from deblur_avatar.pipeline.trajectory import new_trajectory
from deblur_avatar.run import stage
from deblur_avatar.training.params import FitParams, RecipeParams
from deblur_avatar.training.schedule import ScheduleParams
from deblur_avatar.training.supervision import Compared
from deblur_avatar.training.trainer import AvatarFit

PARAMETERS = Path("params.yaml")
METHODS = {
    "agnostic": "paper", "no_nonrigid": "no_nonrigid", "no_fusion": "paper", "n3": "paper",
    "paper": "paper", "n7": "paper", "n9": "paper", "n13": "paper", "cubic": "paper",
    "learned": "paper", "released": "released", "lean": "lean",
}  # fmt: skip  # and the avatar each goes on from
FRAMES = 8
FPS = 60.0
EXPOSURE = 4 / FPS  # seconds
STEPS = 34
TERMS = ("pictures", "regularisers", "priors")
CPU = torch.device("cpu")


def observations(size: int) -> Observations:
    """A person of capsules who swings an arm, in blurred frames of this size."""
    body = capsule_body()
    time_ = torch.linspace(-0.5, 0.5, FRAMES)
    pose = torch.zeros(FRAMES, len(body.parents) - 1, 3)
    pose[:, 15, 2] = time_
    poses = Poses(
        betas=torch.zeros(body.shape_dirs.shape[2]),
        global_orient=torch.zeros(FRAMES, 3),
        body_pose=pose,
        transl=torch.stack([0.1 * time_, 0 * time_, 0 * time_], 1),
    )
    cameras = Cameras(
        Ks=torch.tensor([[[1.8 * size, 0, size / 2], [0, 1.8 * size, size / 2], [0, 0, 1]]]),
        viewmats=look_at(
            torch.tensor([0.0, -0.2, 4.0]), torch.tensor([0, -0.2, 0]), torch.tensor([0.0, 1, 0])
        )[None],
        distortion=torch.zeros(1, 5),
        sizes=torch.tensor([[size, size]]),
        names=("front",),
    )
    generator = torch.Generator().manual_seed(0)
    plain = PlainParams(kind="plain")
    model = PlainAvatar.create(plain, body, poses.betas, FRAMES, 2000, "srgb", generator)
    with torch.no_grad():
        model.gaussians.features.copy_(4 * torch.sin(7 * model.gaussians.means))
        model.gaussians.opacity_logits.fill_(3.0)
    images, alphas = render_avatar(model, poses, cameras.camera(0))
    return Observations(
        frames=(images * 255).round().to(torch.uint8),
        mattes=(alphas * 255).round().to(torch.uint8),
        comparable=None,
        backgrounds=None,
        cameras=cameras,
        crops=torch.tensor([[0.0, 0, size, size]]),
        train_camera=0,
        body=body,
        poses=poses,
        pose_std=math.radians(1.5),
        weights=torch.ones(FRAMES),
        frame_indices=tuple(range(FRAMES)),
        timestamps=torch.arange(FRAMES) / FPS,
        exposure=EXPOSURE,
        averaging_space="srgb",
        train=tuple(range(FRAMES)),
        validation=(),
        depth_known=True,
        occluded_fraction=0.5,
    )


def begin(
    name: str,
    seen: Observations,
    schedule: ScheduleParams,
    precision: Precision | None = None,
    device: torch.device = CPU,
) -> tuple[AvatarFit, Step]:
    """A fit of one method in its last stage, where all its parts take part, and its step.

    All its networks are computed in `precision`; None for the parameters' own.
    """
    recipe = load_params(PARAMETERS, f"avatars.{METHODS[name]}", RecipeParams)
    if precision is not None:
        model_params = recipe.model.model_copy(update={"precision": precision})
        recipe = recipe.model_copy(update={"model": model_params})
    method = load_params(PARAMETERS, f"methods.{name}", MethodParams)
    generator = torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    model = (
        AVATARS[recipe.model.kind]
        .create(
            recipe.model,
            seen.body,
            seen.poses.betas.to(device),
            FRAMES,
            schedule.gaussians,
            seen.averaging_space,
            generator,
        )
        .to(device)
    )
    assert isinstance(model, SplatAvatar)
    with torch.no_grad():
        model.gaussians.opacity_logits.fill_(2.0)
    fusion = method.fusion
    if precision is not None and isinstance(fusion, FusedParams):
        in_precision = fusion.network.model_copy(update={"precision": precision})
        fusion = fusion.model_copy(update={"network": in_precision})
    network = new_network(fusion, model, FRAMES)
    network = None if network is None else network.to(device)
    trajectory = new_trajectory(seen, method.trajectory.motion, generator)
    params = FitParams(
        recipe=recipe, motion=method.trajectory.motion, schedule=schedule,
        fusion=network_params(fusion),
    )  # fmt: skip
    fit = AvatarFit(model, trajectory, seen, params, device, generator, network)
    last = schedule.fusion  # past the last edit of the Gaussians

    def step(index: int) -> None:
        fit.step(last - STEPS + index, method.fusion.supervision, method.fusion.mask)

    return fit, step


def naive(fit: AvatarFit) -> Step:
    """The same step of `paper` without sharing anything between the instants of an exposure."""
    model = fit.avatar

    def render(index: int, rotations: Tensor, transl: Tensor) -> tuple[Tensor, Tensor, Any, Any]:
        camera = fit._targets.camera
        transforms = model.transforms(rotations[None], transl[None])
        frame_state = model.condition(rotations, index, transforms[0], camera.viewmat)
        drawn = model.render(frame_state, transforms, camera)
        white = replace(frame_state, colors=torch.ones_like(frame_state.colors))
        alpha = model.render(white, transforms, camera).image[0, :, :, 0]
        return drawn.image[0], alpha, frame_state, drawn

    def step(iteration: int) -> None:
        now = fit._step(fit._params.schedule.fusion - STEPS + iteration)
        fit._climb(now.iteration)
        index = fit._next_frame()
        target, instants = fit._targets[index], fit.trajectory(index)
        drawn = [
            render(index, *instant)
            for instant in zip(instants.rotations, instants.transl, strict=True)
        ]
        mean = torch.stack([image for image, *_ in drawn]).mean(0)
        alpha = torch.stack([alpha for _, alpha, *_ in drawn]).mean(0)
        centre = instants.centre_rotations, instants.centre_transl
        sharp, sharp_alpha, frame_state, rendering = render(index, *centre)
        assert fit.fusion is not None
        assert frame_state.pose_code is not None
        covered = (alpha > 0) | (sharp_alpha > 0)
        blend = fit.fusion(sharp, covered, frame_state.pose_code, index)
        terms = fit.objective.pictures(
            [Compared(1.0, torch.lerp(sharp, mean, blend), alpha)], alpha, target
        ) | fit.objective.regularisers(rendering, now)
        fit.optimizers.step(now, torch.stack(list(terms.values())).sum())

    return step


def milliseconds(steps: Iterable[Step]) -> list[float]:
    """Median time of each of several steps, taken in turns of a few at a time.

    The first of each turn does not count: it finds the caches full of another's work, as no step of
    a fit does.
    """
    steps = list(steps)
    times: list[list[float]] = [[] for _ in steps]
    for first in range(0, STEPS, TURN):
        for step, taken in zip(steps, times, strict=True):
            for index in range(first, min(first + TURN, STEPS)):
                start = time.perf_counter()
                step(index)
                if index >= WARM_UP and index > first:
                    taken.append(1e3 * (time.perf_counter() - start))
    return [sorted(taken)[len(taken) // 2] for taken in times]


def profiled(fit: AvatarFit, step: Step) -> dict[str, Any]:
    """Shares of a step's time by kind of work, and by part, forward and backward together.

    Two records: marking parts costs time that belongs to no kind of work.
    """
    work = shares_of_work(record(step))
    named: list[tuple[Any, str, str]] = [
        (fit.avatar, "condition", "networks"), (fit.avatar, "transforms", "skinning"),
        (fit.avatar, "_rasterized", "rasterize"),
        *((fit.objective, name, "losses") for name in TERMS),
        (fit.optimizers, "step", "optimiser"), (fit, "_densify", "optimiser"),
        (fit.trajectory, "forward", "skinning"), (fit.fusion, "forward", "networks"),
    ]  # fmt: skip
    for owner, method, part in named:
        if owner is not None:
            setattr(owner, method, mark(getattr(owner, method), part))
    return {"parts": shares_of_parts(record(step)), **work}


def measure(methods: Iterable[str]) -> dict[str, Any]:
    """Some methods, and `paper` written naively in half and in full precision."""
    name = load_params(PARAMETERS, "schedule", str)
    schedule = load_params(PARAMETERS, f"schedules.{name}", ScheduleParams)
    seen = observations(schedule.image_height)
    measured: dict[str, Any] = {"schedule": name, "methods": {}}
    for method in methods:
        fit, step = begin(method, seen, schedule)
        (took,) = milliseconds([step])
        found = profiled(fit, step)
        apart = {part: round(share * took, 2) for part, share in found["parts"].items()}
        measured["methods"][method] = {"ms": round(took, 2), "parts_ms": apart, **found}
    fit, shared = begin("paper", seen, schedule)
    _, shared_full = begin("paper", seen, schedule, "float32")
    naive_step = naive(begin("paper", seen, schedule)[0])
    naive_full = naive(begin("paper", seen, schedule, "float32")[0])
    took, full, naively, fully = milliseconds([shared, shared_full, naive_step, naive_full])
    measured["naive"] = {
        **as_computed(fit.avatar.precision, CPU),
        "ms": round(took, 2),
        "float32_ms": round(full, 2),
        "naive_ms": round(naively, 2),
        "naive_float32_ms": round(fully, 2),
        "faster": round(naively / took, 2),
        "faster_than_float32": round(fully / took, 2),
    }
    return measured


def main(json_file: Path | None, methods: Iterable[str]) -> None:
    """Measure, print, and write."""
    where = machine(4.1)
    with stage("benchmark", "training_step", 0):  # as stages do: memory kept, equal bits
        found = {"machine": where, **measure(methods)}
    print_record(found, json_file, indent=1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the record to this file")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    main(parser.parse_args().json, parser.parse_args().methods)
