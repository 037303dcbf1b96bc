"""Training step on a GPU: with kernels of our own, and with their twins in plain torch.

    python -m benchmarks.gpu_step [--json FILE]

prints JSON: for each size of picture and number of Gaussians, milliseconds of a step of `lean` (the
median) either way, taken in turns on one machine; how many of them the GPU computes, and how many
kernels it is asked for. The scene is a person of capsules. Rasterized is by gsplat both times.
"""

import argparse
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from torch.autograd import DeviceType  # type: ignore[attr-defined]
from torch.profiler import ProfilerActivity, profile

from benchmarks.rasterizer import machine
from benchmarks.record import print_record
from benchmarks.step_profile import TURN, WARM_UP, Step
from benchmarks.training_step import begin, milliseconds, observations
from deblur_avatar.avatars import knn_smoothness
from deblur_avatar.config.reading import load_params
from deblur_avatar.rendering import covariance_factors, posing
from deblur_avatar.run import stage
from deblur_avatar.training import picture_losses
from deblur_avatar.training.schedule import ScheduleParams

PARAMETERS = Path("params.yaml")
# Pixels a side, and as many Gaussians as a person has at that size.
SIZES = ((192, 9_000), (512, 34_000), (1024, 92_000))


@contextmanager
def in_plain_torch() -> Iterator[None]:
    """Kernels' twins compute, on a GPU."""
    with ExitStack() as stack:
        for module in (posing, covariance_factors, knn_smoothness, picture_losses):
            stack.enter_context(patch.object(module, "_cuda_library", lambda: None))
        yield


def waited_for(step: Step) -> Step:
    """The same step, until the GPU has done it."""

    def whole(index: int) -> None:
        step(index)
        torch.cuda.synchronize()

    return whole


def plainly(step: Step) -> Step:
    """The same step in plain torch."""

    def plain(index: int) -> None:
        with in_plain_torch():
            step(index)

    return plain


def asked_of_the_gpu(step: Step) -> dict[str, float]:
    """Milliseconds that the GPU computes in a step, and kernels that it is asked for."""
    for index in range(WARM_UP):
        step(index)
    with profile(activities=[ProfilerActivity.CPU, ProfilerActivity.CUDA]) as profiler:
        for index in range(WARM_UP, WARM_UP + TURN):
            step(index)
    kernels = [event for event in profiler.events() if event.device_type == DeviceType.CUDA]
    took = sum(event.self_device_time_total for event in kernels)
    return {"gpu_ms": round(1e-3 * took / TURN, 2), "gpu_kernels": round(len(kernels) / TURN)}


def measure(device: torch.device) -> list[dict[str, Any]]:
    """A row for each size."""
    name = load_params(PARAMETERS, "schedule", str)
    schedule = load_params(PARAMETERS, f"schedules.{name}", ScheduleParams)
    rows = []
    for size, gaussians in SIZES:
        own = schedule.model_copy(update={"gaussians": gaussians, "image_height": size})
        seen = observations(size)
        steps = [waited_for(begin("lean", seen, own, device=device)[1]) for _ in range(2)]
        ways = {"kernels": steps[0], "plain_torch": plainly(steps[1])}
        took = dict(zip(ways, milliseconds(ways.values()), strict=True))
        row: dict[str, Any] = {"size": size, "gaussians": gaussians}
        for way, step in ways.items():
            row[way] = {"ms": round(took[way], 2), **asked_of_the_gpu(step)}
        row["faster"] = round(took["plain_torch"] / took["kernels"], 2)
        rows.append(row)
    return rows


def main(json_file: Path | None) -> None:
    """Measure, print, and write."""
    if not torch.cuda.is_available():
        raise SystemExit("this measures steps on a GPU, and torch sees none here")
    with stage("benchmark", "gpu_step", 0):
        found = {"machine": machine(4.1), "rows": measure(torch.device("cuda"))}
    print_record(found, json_file, indent=1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the record to this file")
    main(parser.parse_args().json)
