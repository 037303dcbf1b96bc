"""Time to quality: how long a fit takes until it is as good as a long one, within 0.2 dB.

    python -m benchmarks.time_to_quality --json FILE [--sizes 192 512] [--methods lean]

films the synthetic studio at each size, fits it with the schedule of that size, and scores avatars
kept on the way against sharp novel views (PSNR over the surface that the training camera saw). The
reference is what a run of 15,000 iterations without levels reaches with the same settings: it takes
hours, is run once by `--reference`, which goes on where it was stopped, and stands in `--references
FILE`, which a record is compared with. Seconds are of fitting alone, by the clock and of the
processor; a record wants an idle machine, and says of each row how busy it was. Rows that a record
has of other sizes, methods, schedules, seeds and devices stay in it, compared with the references
of now (`--methods` and none: nothing is fitted, that is all). `--beside` adds what a second fit on
the same cores costs. Fits run on a GPU where there is one (`DEBLUR_AVATAR_DEVICE`).
"""

import argparse
import json
import multiprocessing
import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

from benchmarks.rasterizer import machine
from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.bodies.registry import BodyParams
from deblur_avatar.body_estimation.landmarks import detect_with_mediapipe
from deblur_avatar.config.reading import load_params
from deblur_avatar.evaluation.comparisons import compare_views, mean_scores
from deblur_avatar.evaluation.truth_views import TruthView, truth_views
from deblur_avatar.files import write_json
from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.methods import MethodParams
from deblur_avatar.pipeline.blur import BlurParams, blur
from deblur_avatar.pipeline.body import build_body
from deblur_avatar.pipeline.clip import ClipParams, load_clip
from deblur_avatar.pipeline.fusion import fuse
from deblur_avatar.pipeline.preprocess import PreprocessParams, preprocess
from deblur_avatar.pipeline.trajectory import fit_trajectory
from deblur_avatar.pipeline.warmup import warm_up
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.resume import RunFolder, run_key
from deblur_avatar.training.schedule import PAPER_ITERATIONS, ScheduleParams

PARAMS = Path("params.yaml")
SCENE = "studio"
AVATARS = {"lean": "lean", "agnostic": "paper", "paper": "paper"}  # of methods
SCHEDULES = {192: "medium", 512: "large", 1024: "huge"}  # by size
WITHIN_DB = 0.2
# What tells rows apart, and what those have that do not say.
TOLD_APART = {"size": 0, "method": "", "schedule": "", "seed": 0, "device": "cpu"}
VIEWS = 12  # that each avatar is scored on
MOMENTS = 12  # at which avatars are kept
BESIDE = ScheduleParams(
    warmup=40, trajectory=100, fusion=200, gaussians=6000, image_height=192, levels=()
)


@dataclass(frozen=True)
class Kept:
    """An avatar on the way, and what it had taken."""

    seconds: float
    processor_seconds: float
    avatar: Avatar
    motion: Motion


def filmed(size: int, folder: Path) -> tuple[Observations, Reference]:
    """The studio at one size, filmed once and kept in a folder."""
    changes = {"image_size": size, "test_cameras": 4, "test_stride": 16, "samples_per_axis": 2}
    return filmed_scene(PARAMS, SCENE, changes, folder / f"{SCENE}_{size}", size)


def filmed_scene(
    params: Path, scene: str, changes: Mapping[str, Any], place: Path, size: int
) -> tuple[Observations, Reference]:
    """A scene of a studio with some of its settings changed, filmed once and kept in a folder.

    Args:
        params: the file that has the scene.
        scene: its name there.
        changes: settings of its `clip` that are others here.
        place: the folder; what it holds is not compared with `changes`.
        size: of pictures that are fitted, pixels.
    """
    if not (place / "reference").exists():
        body = build_body(load_params(params, "bodies.anny", BodyParams))
        source = load_params(params, f"scenes.{scene}.clip", ClipParams).model_copy(update=changes)
        generator = torch.Generator().manual_seed(run.derive_seed(0, "clip", scene))
        clip, reference = load_clip(source, body, detect=detect_with_mediapipe, generator=generator)
        blurred = blur(clip, load_params(params, f"scenes.{scene}.blur", BlurParams))
        prepared = load_params(params, f"scenes.{scene}.preprocess", PreprocessParams)
        seen = preprocess(
            blurred, body, prepared, image_height=size, detect=detect_with_mediapipe
        ).blurred
        seen.save(place / "observations")
        reference.save(place / "reference")
    return Observations.load(place / "observations"), Reference.load(place / "reference")


def settings_of(method: str, avatar: str | None = None) -> tuple[RecipeParams, MethodParams]:
    """What `params.yaml` has for a method, and for an avatar, the method's own unless told."""
    return (
        load_params(PARAMS, f"avatars.{avatar or AVATARS[method]}", RecipeParams),
        load_params(PARAMS, f"methods.{method}", MethodParams),
    )


def fitted(
    observations: Observations,
    recipe: RecipeParams,
    method: MethodParams,
    schedule: ScheduleParams,
    moments: frozenset[int],
    place: Path | None = None,
    inputs: Sequence[Path] = (),
    seed: int = 0,
) -> list[Kept]:
    """Fit an avatar with a motion, and keep avatars after some iterations and at the end.

    Args:
        observations: of the person.
        recipe: of the avatar.
        method: the motion, and what follows the warm-up.
        schedule: how long, and how large.
        moments: the iterations after which avatars are kept.
        place: a folder in which a fit that was stopped goes on; its seconds are those since then.
        inputs: folders that the observations were read from; a fit of others begins anew there.
        seed: of its draws.
    """
    clocks: dict[int, tuple[float, float]] = {}
    begin = time.perf_counter(), time.process_time()

    def watch(iteration: int, terms: Mapping[str, float]) -> None:
        clocks[iteration] = time.perf_counter() - begin[0], time.process_time() - begin[1]

    with TemporaryDirectory() if place is None else nullcontext(place) as there:
        device = run.chosen_device()
        key = run_key([seed, sorted(moments), device], [recipe, method, schedule], inputs)
        generator = torch.Generator().manual_seed(seed)
        common: dict[str, Any] = {"device": device, "generator": generator, "report": watch}

        def folder(stage: str) -> RunFolder:
            path = Path(there) / stage
            path.mkdir(parents=True, exist_ok=True)
            return RunFolder(path, key, moments)

        avatar, checkpoint, _ = warm_up(
            observations, recipe, schedule, folder=folder("warmup"), **common
        )
        avatar, motion, checkpoint, _ = fit_trajectory(
            observations, avatar, checkpoint, recipe, method.trajectory, schedule,
            folder=folder("trajectory"), **common,
        )  # fmt: skip
        avatar, motion, _ = fuse(
            observations, avatar, motion, checkpoint, recipe, method.trajectory.motion,
            method.fusion, schedule, folder=folder("fusion"), **common,
        )  # fmt: skip
        kept = [
            Kept(
                *clocks[int(path.name)], Avatar.load(path / "avatar"), Motion.load(path / "motion")
            )
            for path in sorted(Path(there).glob("*/snapshots/*"), key=lambda path: path.name)
        ]
    return [*kept, Kept(*clocks[schedule.fusion], avatar, motion)]


def scores_of_views(
    views: Sequence[TruthView], observations: Observations, reference: Reference, kept: Kept
) -> dict[str, float | None]:
    """Mean scores of an avatar over test views."""
    model = avatar_from_artifact(kept.avatar, observations.body, run.chosen_device())
    scores = mean_scores(compare_views(model, observations, reference, kept.motion, views))
    assert scores is not None
    return scores


def novel_views(observations: Observations, reference: Reference) -> list[TruthView]:
    """The test views of frames that are trained on."""
    return [view for view in truth_views(observations, reference) if not view.novel_pose]


def psnr_seen(observations: Observations, reference: Reference, kept: Kept) -> float:
    """PSNR of novel views over the surface that the training camera saw, dB."""
    views = evenly_spaced(novel_views(observations, reference), VIEWS)
    value = scores_of_views(views, observations, reference, kept)["psnr_seen"]
    assert value is not None
    return value


def first_within(scores: Sequence[float], wanted: float | None) -> int | None:
    """Which score is the first that is near enough to what is wanted, dB; None if none is."""
    near = (i for i, dB in enumerate(scores) if wanted is not None and dB >= wanted - WITHIN_DB)
    return next(near, None)


def row_of(
    method: str, size: int, folder: Path, references: Mapping[str, float], name: str, seed: int = 0
) -> dict[str, Any]:
    """Fit one method at one size, and score it on the way.

    Args:
        method: its name.
        size: of pictures, pixels.
        folder: where films are kept.
        references: what a long run reaches, dB, by `<scene>-<size>-<method>`.
        name: of the schedule.
        seed: of the fit's draws; the film and the reference have their own.
    """
    schedule = load_params(PARAMS, f"schedules.{name}", ScheduleParams)
    moments = frozenset(round(schedule.fusion * (i + 1) / MOMENTS) for i in range(MOMENTS - 1))
    observations, reference = filmed(size, folder)
    here = machine(0.0)
    kept = fitted(observations, *settings_of(method), schedule, moments, seed=seed)
    scores = [psnr_seen(observations, reference, one) for one in kept]
    wanted = references.get(f"{SCENE}-{size}-{method}")
    first = first_within(scores, wanted)
    good = None if first is None else kept[first]
    return {
        "scene": SCENE,
        "size": size,
        "gaussians": len(kept[-1].avatar.means),
        "method": method,
        "schedule": name,
        "seed": seed,
        "device": run.chosen_device().type,
        "iterations": schedule.fusion,
        "seconds_to_within_0.2_db": good and good.seconds,
        "processor_seconds_to_within_0.2_db": good and good.processor_seconds,
        "seconds": kept[-1].seconds,
        "processor_seconds": kept[-1].processor_seconds,
        "final_psnr_seen": scores[-1],
        "reference_psnr_seen": wanted,
        "curve": [[one.seconds, score] for one, score in zip(kept, scores, strict=True)],
        "commit": here["commit"],
        "load_before": here["load_before"],
    }


def judged(row: Mapping[str, Any], references: Mapping[str, float]) -> dict[str, Any]:
    """A row beside a reference that was fitted, or fitted again, after it.

    Args:
        row: what a fit scored on the way. When its processor had come so far it does not say.
        references: dB, by `<scene>-<size>-<method>`.
    """
    wanted = references.get(f"{row['scene']}-{row['size']}-{row['method']}")
    if row["reference_psnr_seen"] == wanted:
        return dict(row)
    first = first_within([dB for _, dB in row["curve"]], wanted)
    return {
        **row,
        "seconds_to_within_0.2_db": None if first is None else row["curve"][first][0],
        "processor_seconds_to_within_0.2_db": None,
        "reference_psnr_seen": wanted,
    }


def with_rows(
    known: Mapping[str, Any],
    rows: Sequence[Mapping[str, Any]],
    beside: float | None,
    references: Mapping[str, float],
) -> dict[str, Any]:
    """A record with these rows in place of those that differ in nothing of `TOLD_APART`.

    All rows are compared with the references that are known now.

    Raises:
        SystemExit: if what is known was measured on another machine.
    """
    here = machine(0.0)
    before = known.get("machine", here)
    for fact in ("cpu", "instructions", "cores", "threads", "gpu"):
        if before[fact] != here[fact]:
            raise SystemExit(
                f"this machine's {fact} is {here[fact]}, the record's {before[fact]}: "
                "give a file of its own, --json"
            )
    all_rows = [*known.get("rows", []), *rows]
    latest = {
        tuple(row.get(name, unsaid) for name, unsaid in TOLD_APART.items()): judged(row, references)
        for row in all_rows
    }
    return {
        "machine": here,
        "rows": [row for _, row in sorted(latest.items())],
        "beside_another": known.get("beside_another") if beside is None else beside,
    }


def reference_of(method: str, size: int, folder: Path) -> float:
    """What 15,000 iterations without levels reach, dB."""
    schedule = load_params(PARAMS, f"schedules.{SCHEDULES[size]}", ScheduleParams)
    ends = {"warmup": 3000, "trajectory": 7000, "fusion": PAPER_ITERATIONS}
    whole = schedule.model_copy(update={**ends, "levels": ()})
    observations, reference = filmed(size, folder)
    place = folder / f"{SCENE}_{size}_{method}_reference"
    film = folder / f"{SCENE}_{size}" / "observations"
    kept = fitted(observations, *settings_of(method), whole, frozenset(), place, [film])
    return psnr_seen(observations, reference, kept[-1])


def _fit_for_a_while(folder: Path) -> float:
    torch.set_num_threads(1)
    observations, _ = filmed(192, folder)
    return fitted(observations, *settings_of("lean"), BESIDE, frozenset())[-1].seconds


def beside_another(folder: Path) -> float:
    """A fit's time beside a second one on the same cores, against twice its time alone."""
    alone = _fit_for_a_while(folder)
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        both = pool.map(_fit_for_a_while, [folder, folder])
    return max(both) / (2 * alone)


def main(arguments: argparse.Namespace) -> None:
    """Measure, print, and write."""
    torch.set_num_threads(1)
    torch.backends.cudnn.allow_tf32 = False  # as stages have it
    path: Path = arguments.references
    references: dict[str, float] = json.loads(path.read_text()) if path.exists() else {}
    if arguments.reference:
        for size in arguments.sizes:
            for method in arguments.methods:
                value = reference_of(method, size, arguments.folder)
                references[f"{SCENE}-{size}-{method}"] = value
                write_json(path, dict(sorted(references.items())))
        return
    known = arguments.json and arguments.json.exists() and json.loads(arguments.json.read_text())
    record = with_rows(known or {}, [], None, references)
    for size in arguments.sizes:
        for method in arguments.methods:
            name = arguments.schedule or SCHEDULES[size]
            for seed in arguments.seeds:
                row = row_of(method, size, arguments.folder, references, name, seed)
                record = with_rows(record, [row], None, references)
                print(json.dumps(row), flush=True)
                if arguments.json:
                    write_json(arguments.json, record)
    if arguments.beside:
        record = with_rows(record, [], beside_another(arguments.folder), references)
    if arguments.json:
        write_json(arguments.json, record)
    print(json.dumps(record, indent=1))


def _arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the record to this file")
    parser.add_argument("--sizes", type=int, nargs="+", choices=SCHEDULES, default=[192, 512])
    parser.add_argument("--methods", nargs="*", choices=AVATARS, default=["lean"])
    parser.add_argument("--reference", action="store_true", help="run 15,000 iterations instead")
    parser.add_argument("--schedule", help="of params.yaml, instead of the size's own")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="of the fits' draws")
    parser.add_argument("--beside", action="store_true", help="measure two fits at once, too")
    parser.add_argument(
        "--references",
        type=Path,
        default=Path("benchmarks/results/time_to_quality_references.json"),
    )
    parser.add_argument(
        "--folder", type=Path, default=Path("data/time_to_quality"), help="where films are kept"
    )
    return parser.parse_args(words)


if __name__ == "__main__":
    main(_arguments())
