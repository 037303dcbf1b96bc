"""Posed mesh benchmark: what GoMAvatar asks of a mesh at each step, by the kernels and their twins.

    python -m benchmarks.posed_mesh [--json FILE]

prints JSON: for each function milliseconds forward and backward (medians of processor time) of the
native kernel and of plain torch, in turns in one run, and how many times longer torch takes. The
mesh is a closed one of 27,720 faces, as many as the body has, in three poses; a picture has 192
pixels a side. `seen_places` has no gradient.
"""

import argparse
import json
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import torch
from torch import Tensor

from benchmarks.rasterizer import machine
from deblur_avatar.avatars import mesh_gaussians, mesh_terms
from deblur_avatar.avatars.mesh_normals import posed_normals
from deblur_avatar.avatars.surface_projection import vertex_normals
from deblur_avatar.geometry.cameras import Camera, look_at
from deblur_avatar.rendering import normal_maps
from deblur_avatar.run import one_thread

RINGS, SECTORS = 100, 140
POSES = 3
SIZE = 192  # pixels
THICKNESS = 1e-3  # metres
ROUNDS = 11

Function = Callable[..., Any]


def closed_mesh(rings: int = RINGS, sectors: int = SECTORS) -> tuple[Tensor, Tensor]:
    """Vertices and faces of an upright egg, 1.7 metres high."""
    down = (torch.arange(1, rings) * math.pi / rings)[:, None]
    around = torch.arange(sectors) * 2 * math.pi / sectors
    places = [0.3 * down.sin() * around.sin(), 0.85 * down.cos().expand(-1, sectors)]
    places += [0.2 * down.sin() * around.cos()]
    poles = torch.tensor([[0, 0.85, 0], [0, -0.85, 0]])
    vertices = torch.cat([torch.stack(places, -1).flatten(0, 1), poles])
    here = torch.arange((rings - 1) * sectors).unflatten(0, (rings - 1, sectors))
    a, b, c, d = here[:-1], here[1:], here[1:].roll(-1, 1), here[:-1].roll(-1, 1)
    top, bottom = torch.full((sectors,), len(here.flatten())), here[-1]
    faces = [torch.stack(one, -1).flatten(0, -2) for one in ((a, b, c), (a, c, d))]
    faces.append(torch.stack([top, here[0], here[0].roll(-1)], -1))
    faces.append(torch.stack([top + 1, bottom.roll(-1), bottom], -1))
    return vertices.float(), torch.cat(faces)


def functions(
    vertices: Tensor, faces: Tensor
) -> dict[str, tuple[Function, Function, Sequence[Tensor]]]:
    """The kernel, its twin, and what both are given."""
    generator = torch.Generator().manual_seed(0)
    posed = vertices + 2e-3 * torch.randn(POSES, *vertices.shape, generator=generator)
    shapes = torch.eye(3) + 0.1 * torch.randn(len(faces), 3, 3, generator=generator)
    edges, pairs = mesh_terms.mesh_edges(faces), mesh_terms.adjacent_faces(faces)
    K = torch.tensor([[1.6 * SIZE, 0, SIZE / 2], [0, 1.6 * SIZE, SIZE / 2], [0, 0, 1]])
    up = torch.tensor([0.0, 1.0, 0.0])
    camera = Camera(K, look_at(torch.tensor([0.0, 0.0, 3.0]), torch.zeros(3), up), SIZE, SIZE)

    def bound(function: Function, *given: Any) -> Function:
        return lambda *tensors: function(*tensors, *given)

    def all_places(see: Function) -> Function:
        return lambda posed: [see(one, faces, camera) for one in posed.detach()]

    return {
        "face_gaussians": (
            lambda v, s: mesh_gaussians.face_gaussians(v, faces, s, THICKNESS),
            lambda v, s: mesh_gaussians.face_gaussians_reference(v, faces, s, THICKNESS),
            (posed, shapes),
        ),
        "posed_normals": (
            bound(posed_normals, faces),
            lambda v: torch.stack([vertex_normals(one, faces) for one in v]),
            (posed,),
        ),
        "laplacian": (
            bound(mesh_terms.laplacian, edges),
            bound(mesh_terms.laplacian_reference, edges),
            (posed,),
        ),
        "normal_consistency": (
            bound(mesh_terms.normal_consistency, faces, pairs),
            bound(mesh_terms.normal_consistency_reference, faces, pairs),
            (posed,),
        ),
        "seen_places": (
            all_places(normal_maps.seen_places),
            all_places(normal_maps.seen_places_reference),
            (posed,),
        ),
    }


def milliseconds(function: Function, given: Sequence[Tensor]) -> tuple[float, float]:
    """Processor time of one call, and of its gradients if it has any."""
    tensors = [value.clone().requires_grad_() for value in given]
    begin = time.process_time()
    found = function(*tensors)
    forward = time.process_time() - begin
    results = [found] if isinstance(found, Tensor) else found
    if not isinstance(results[0], Tensor):
        return 1e3 * forward, 0.0
    total = sum((one.sum() for one in results), torch.zeros(()))
    begin = time.process_time()
    total.backward()
    return 1e3 * forward, 1e3 * (time.process_time() - begin)


def measured(rounds: int = ROUNDS, mesh: tuple[Tensor, Tensor] | None = None) -> dict[str, Any]:
    """Every function, kernel and twin in turns."""
    rows = {}
    for name, (kernel, twin, given) in functions(*(mesh or closed_mesh())).items():
        times: dict[str, list[tuple[float, float]]] = {"kernel": [], "torch": []}
        with torch.no_grad():
            kernel(*given)  # compiles, and finds its lists
        for _ in range(rounds):
            times["kernel"].append(milliseconds(kernel, given))
            times["torch"].append(milliseconds(twin, given))
        row = {
            way: {
                "forward_ms": median(one for one, _ in taken),
                "backward_ms": median(other for _, other in taken),
            }
            for way, taken in times.items()
        }
        longer = sum(row["torch"].values()) / sum(row["kernel"].values())
        rows[name] = {**row, "torch_over_kernel": longer}
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write them here")
    target = parser.parse_args().json
    with one_thread():
        told = {"machine": machine(0.0), "poses": POSES, "functions": measured()}
    text = json.dumps(told, indent=1)
    if target is not None:
        target.write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
