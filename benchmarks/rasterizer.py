"""Rasterizer benchmark: one training step in each backend, forward and backward.

    python -m benchmarks.rasterizer --json FILE

prints a table and writes a record. Times are the least of many, through autograd, of red, green,
blue and alpha; for five poses the mean of the pictures, as training wants it. gsplat's plain-torch
functions take part where that package can be imported, CUDA where there is a GPU too. To keep it
out of an environment: `pip install --no-deps --target FOLDER gsplat==1.5.3 rich markdown-it-py
mdurl pygments`, then `PYTHONPATH=FOLDER`. On a machine that is busy with other work,
`--processor-time` with one thread (OMP_NUM_THREADS=1) counts what this process used instead.
"""

import argparse
import json
import os
import platform
import subprocess
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks.capsule_person import Person, capsule_person
from benchmarks.gsplat_in_torch import rasterize_by_gsplat
from deblur_avatar.rendering import cpu, native_build
from deblur_avatar.rendering.rasterize import rasterize
from deblur_avatar.run import kernel_threads

SIZES = ((5_000, 128), (20_000, 256), (50_000, 512))  # Gaussians, pixels a side
BATCHES = (1, 5)

# Errors are measured where float32 depths rarely tie: at 50,000 Gaussians near-equal depths swap
# their order between float32 and float64, and any two rasterizers then differ.
ERROR_SCENE = (2_000, 96)

# Least cycles that a visit (a Gaussian at 16 pixels) needs for its arithmetic on two 512-bit
# multiply-add and two 512-bit add pipes, forward and backward, by counting instructions.
CYCLES_PER_VISIT = 8 + 13

SECONDS = 3.0  # spent on each number, at least
REPEATS = (3, 400)  # at least, at most


@dataclass(frozen=True, kw_only=True)
class Row:
    """One measurement; times in milliseconds.

    `bound_ms` is what the inner loops would take if they did arithmetic and nothing else;
    `error` the largest relative error of the picture and of any gradient, against float64.
    """

    backend: str
    gaussians: int
    size: int
    batch: int
    forward_ms: float
    forward_backward_ms: float
    bound_ms: float | None
    error: float


Clock = Callable[[], float]

# From leaf tensors, camera and size to mean picture and mean alpha.
Draw = Callable[[Person, int], tuple[Tensor, Tensor]]


def draw_by(backend: str) -> Draw:
    """Draw through `rasterize`."""

    def draw(person: Person, size: int) -> tuple[Tensor, Tensor]:
        found = rasterize(
            **vars(person),
            width=size,
            height=size,
            average=len(person.means) > 1,
            backend=backend,
        )
        return found.image, found.alpha

    return draw


def draw_by_gsplat(person: Person, size: int) -> tuple[Tensor, Tensor]:
    """Draw by gsplat's torch functions."""
    return rasterize_by_gsplat(**vars(person), width=size, height=size)


def contestants() -> dict[str, Draw]:
    """List what can run here."""
    found = {"cpu": draw_by("cpu"), "reference": draw_by("reference")}
    try:
        import gsplat.cuda._torch_impl  # noqa: F401

        found["gsplat, plain torch"] = draw_by_gsplat
        if torch.cuda.is_available():
            found["cuda"] = draw_by("cuda")
    except ImportError:
        print("gsplat cannot be imported and takes no part")
    return found


def as_leaves(person: Person, device: str, dtype: torch.dtype = torch.float32) -> Person:
    """Move a scene and ask for its gradients."""
    moved = {name: tensor.to(device, dtype) for name, tensor in vars(person).items()}
    for name in ("means", "covars", "opacities", "colors"):
        moved[name] = moved[name].detach().clone().requires_grad_()
    return Person(**moved)


def run(draw: Draw, person: Person, size: int, pulls: list[Tensor]) -> list[Tensor]:
    """Draw and differentiate; returns picture, alpha and gradients."""
    picture = draw(person, size)
    leaves = [person.means, person.covars, person.opacities, person.colors]
    return [*picture, *torch.autograd.grad(picture, leaves, pulls)]


def pulls_at(size: int) -> list[Tensor]:
    """Make some gradient of mean picture and alpha."""
    generator = torch.Generator().manual_seed(7)
    shapes = ((1, size, size, 3), (1, size, size))
    return [torch.randn(shape, generator=generator) for shape in shapes]


def least_ms(call: Callable[[], object], device: str, clock: Clock) -> float:
    """Repeat for some seconds and keep the least time, milliseconds."""
    call()
    best, spent, count = float("inf"), 0.0, 0
    while count < REPEATS[0] or (spent < SECONDS and count < REPEATS[1]):
        if device == "cuda":
            torch.cuda.synchronize()
        start = clock()
        call()
        if device == "cuda":
            torch.cuda.synchronize()
        taken = clock() - start
        best, spent, count = min(best, taken), spent + taken, count + 1
    return round(1000 * best, 3)


def error_of(draw: Draw, device: str) -> float:
    """Compare one pose with the reference in float64."""
    count, size = ERROR_SCENE
    person = capsule_person(count, size, 1)
    pulls = pulls_at(size)
    exact = run(
        draw_by("reference"),
        as_leaves(person, "cpu", torch.float64),
        size,
        [pull.double() for pull in pulls],
    )
    found = run(draw, as_leaves(person, device), size, [pull.to(device) for pull in pulls])
    return max(
        float((a.cpu().double() - b).norm() / b.norm()) for a, b in zip(found, exact, strict=True)
    )


def bound_ms(person: Person, size: int, ghz: float) -> float | None:
    """Count the kernel's visits, and from them the time that their arithmetic takes."""
    try:
        native = cpu.kernel()
    except native_build.BuildError:
        return None
    picture, _ = draw_by("cpu")(as_leaves(person, "cpu"), size)
    words = picture.grad_fn.work["visits"]  # type: ignore[union-attr]
    bits = torch.tensor([bin(byte).count("1") for byte in range(256)])
    visits = int(bits[words.long()].sum()) * native.lanes / 16
    return round(visits * CYCLES_PER_VISIT / (ghz * 1e6) / kernel_threads(), 3)


def measure(ghz: float, clock: Clock) -> list[Row]:
    """Run all contestants at all sizes."""
    rows = []
    for backend, draw in contestants().items():
        device = "cuda" if backend == "cuda" else "cpu"
        error = float(f"{error_of(draw, device):.1e}")
        for gaussians, size in SIZES:
            for batch in BATCHES:
                scene = capsule_person(gaussians, size, batch)
                person = as_leaves(scene, device)
                pulls = [pull.to(device) for pull in pulls_at(size)]

                def forward(draw: Draw = draw, person: Person = person, size: int = size) -> None:
                    with torch.no_grad():
                        draw(person, size)

                def both(
                    draw: Draw = draw,
                    person: Person = person,
                    size: int = size,
                    pulls: list[Tensor] = pulls,
                ) -> None:
                    run(draw, person, size, pulls)

                row = Row(
                    backend=backend,
                    gaussians=gaussians,
                    size=size,
                    batch=batch,
                    forward_ms=least_ms(forward, device, clock),
                    forward_backward_ms=least_ms(both, device, clock),
                    bound_ms=bound_ms(scene, size, ghz) if backend == "cpu" else None,
                    error=error,
                )
                rows.append(row)
                print_row(row)
    return rows


def machine(ghz: float) -> dict[str, Any]:
    """Say where and with what the numbers were taken."""
    names = [
        line.split(":", 1)[1].strip()
        for line in _read("/proc/cpuinfo").splitlines()
        if line.startswith("model name")
    ]
    try:
        compiler = native_build.find_compiler()
        version = subprocess.run([*compiler, "--version"], capture_output=True, text=True).stdout
    except native_build.BuildError:
        version = "none"
    return {
        "commit": _git("rev-parse", "HEAD"),
        "changed_since_commit": bool(
            _git("status", "--porcelain", "--", "deblur_avatar/rendering")
        ),
        "cpu": names[0] if names else platform.processor(),
        "instructions": torch.backends.cpu.get_cpu_capability(),
        "cores": os.cpu_count(),
        "threads": kernel_threads(),
        "ghz_assumed_for_bound": ghz,
        "load_before": [round(load, 2) for load in os.getloadavg()],
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "system": f"{platform.system()} {platform.machine()}",
        "compiler": version.splitlines()[0] if version else "unknown",
        "python": platform.python_version(),
        "torch": torch.__version__,
    }


def _read(path: str) -> str:
    try:
        return Path(path).read_text()
    except OSError:
        return ""


def _git(*arguments: str) -> str:
    result = subprocess.run(["git", *arguments], capture_output=True, text=True)
    return result.stdout.strip()


def print_row(row: Row) -> None:
    """Print one line of the table."""
    bound = "" if row.bound_ms is None else f"{row.bound_ms:9.2f}"
    print(
        f"{row.backend:20} {row.gaussians:7} {row.size:5} {row.batch:3}"
        f" {row.forward_ms:11.2f} {row.forward_backward_ms:11.2f} {bound:9} {row.error:9.1e}",
        flush=True,
    )


def main(json_file: Path | None, ghz: float, processor_time: bool) -> None:
    """Measure, print, and write."""
    where = {**machine(ghz), "processor_time": processor_time}
    print(json.dumps(where, indent=2))
    print(
        f"{'backend':20} {'N':>7} {'size':>5} {'B':>3}"
        f" {'forward ms':>11} {'+ backward':>11} {'bound':>9} {'error':>9}"
    )
    rows = measure(ghz, time.process_time if processor_time else time.perf_counter)
    if json_file:
        record = {"machine": where, "rows": [asdict(row) for row in rows]}
        json_file.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the record to this file")
    parser.add_argument("--ghz", type=float, default=4.1, help="clock that the bound assumes")
    parser.add_argument("--processor-time", action="store_true", help="not the clock's")
    arguments = parser.parse_args()
    main(arguments.json, arguments.ghz, arguments.processor_time)
