"""Tables of the report: which are shown of one scene, and the facts above them.

Conventions. Results are contents of metrics files by method; `blur` and `preprocess` are those of
the stages of these names. A table whose numbers nobody measured is left out.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from deblur_avatar.evaluation.metrics import HEADLINE, shown_metrics
from deblur_avatar.reporting.results_table import (
    BOUNDS,
    GAUSSIANS,
    HELD_OUT_BLUR,
    MEMORY,
    ON_DISK,
    RENDERING,
    SIZE,
    START,
    TO_CEILING,
    TO_PAPER,
    TRAINING,
    Column,
    Table,
    image_columns,
    look_up,
    measured,
    recovery_columns,
    results_table,
)

NOT_KNOWN = "not known"
_SPACES = {"srgb": "sRGB values", "linear": "linear light"}

COST = (
    TRAINING, TO_PAPER, RENDERING, MEMORY, GAUSSIANS, SIZE, ON_DISK,
    Column(("model", "virtual_poses_mean"), "virtual poses", "a frame", 1),
    Column(("run", "iterations"), "iterations", "", 0),
)  # fmt: skip
MOTION_ERRORS = (
    Column(("motion", "joint_error_mm"), "joints", "mm", 1, -1),
    Column(("motion", "surface_error_mm"), "surface", "mm", 1, -1),
    Column(("motion", "joint_error_deg"), "joint angles", "degrees", 2, -1),
    Column(("motion", "travel_error_mm"), "travel in exposure", "mm", 1, -1),
    Column(("motion", "direction_accuracy"), "right direction", "%", 0, 1, factor=100.0),
)
REBLUR = (HELD_OUT_BLUR, Column(("reblur", "psnr_train"), "those trained on", "dB", 2, 1))
FIT = (
    Column(("reprojection_px",), "landmarks, median", "pixels", 1),
    Column(("iou",), "silhouette overlap", "IoU", 3),
)
ESTIMATED_STEPS = (
    Column(("steps", "mattes", "iou"), "mattes", "IoU", 3, 1),
    Column(("steps", "mattes", "mae"), "mattes, difference", "of 1", 4, -1),
    Column(("steps", "focal", "estimated_px"), "focal length", "pixels", 0),
    Column(("steps", "focal", "true_px"), "the true one", "pixels", 0),
    Column(("steps", "poses", "initial", "rooted_mm"), "first poses", "mm", 1, -1),
    Column(("steps", "poses", "fitted", "rooted_mm"), "fitted poses", "mm", 1, -1),
    Column(("steps", "poses", "initial", "registered_mm"), "first, aligned", "mm", 1, -1),
    Column(("steps", "poses", "fitted", "registered_mm"), "fitted, aligned", "mm", 1, -1),
    Column(("steps", "poses", "fitted", "depth_ratio"), "depth", "of the true one", 3),
    Column(("in_true_poses", "psnr_seen"), "avatar in true poses", "PSNR seen", 2, 1),
)


def tables_of(
    results: Mapping[str, Mapping[str, Any]], preprocess: Mapping[str, Any]
) -> list[Table]:
    """The tables of one scene, in the order of the page."""
    tables = [_novel_views(results) or _held_out_blur(results)]
    novel_pose = measured(results, _views("novel_pose"))
    if novel_pose:
        note = "The last part of the clip, which no method was trained on."
        tables.append(results_table(results, novel_pose, title="Novel poses", note=note))
    cameras = _camera_columns(results)
    if cameras:
        note = "PSNR over all pixels, and over the person."
        tables.append(results_table(results, cameras, title="Camera by camera", note=note))
    if measured(results, MOTION_ERRORS):
        tables.append(
            results_table(
                _with_start(results),
                (*MOTION_ERRORS, HELD_OUT_BLUR),
                missing=NOT_KNOWN,
                bounds=(*BOUNDS, START),
                title="Motion against the truth",
                note="In italics besides: the poses that every method starts from.",
            )
        )
    aligned = measured(results, _aligned_columns(results))
    if aligned:
        note = (
            "One affine map of colours for each camera and method, fitted to the person's pixels "
            "of that camera, since cameras differ; PSNR of the seen surface. Body: how far body "
            "and person overlap in each view (IoU)."
        )
        title = "Camera by camera, colours aligned"
        tables.append(results_table(results, aligned, title=title, note=note))
    if measured(results, ESTIMATED_STEPS):
        tables.append(
            results_table(
                results, ESTIMATED_STEPS, missing=NOT_KNOWN, title="What was estimated",
                note="Joints relative to the pelvis; aligned: by the best similarity of a frame.",
            )
        )  # fmt: skip
    cost = measured(results, COST)
    if cost:
        note = "Training counts the warm-up in full, though methods may share it."
        tables.append(results_table(results, cost, missing=NOT_KNOWN, title="Cost", note=note))
    fit = {name: entry for name, entry in (preprocess.get("fit") or {}).items() if entry}
    if fit:
        title = "How well the estimated body explains each camera"
        note = "Estimated from the blurred frames."
        tables.append(results_table(fit, FIT, of="camera", title=title, note=note))
    return tables


def _views(group: str) -> tuple[Column, ...]:
    return image_columns(group, shown_metrics("page", "short"))


def _novel_views(results: Mapping[str, Mapping[str, Any]]) -> Table | None:
    """Against the truth; None for footage without one."""
    if not measured(results, image_columns("image", [HEADLINE])):
        return None
    # Perceptual distance stays even where nobody could measure it: readers look for it.
    always = image_columns("image", ["lpips_vgg"])
    columns = [
        column
        for column in (*_views("image"), *recovery_columns(), TO_CEILING)
        if column in always or measured(results, [column])
    ]
    return results_table(results, columns, title="Novel views", note=_pictures(results))


def _held_out_blur(results: Mapping[str, Mapping[str, Any]]) -> Table:
    note = (
        "This footage has no sharp truth. Blurred frames that were set aside are compared with "
        "the avatar's renders averaged over the exposure (PSNR)."
    )
    return results_table(results, REBLUR, title="Held-out blurred frames", note=note)


def estimated_shutters(results: Mapping[str, Any]) -> list[str]:
    """How long the shutter was open as each method found it, of footage that does not say."""
    return [
        f"{method} finds that the shutter was open for {1e3 * result['shutter_s']:.1f} ms"
        for method, result in results.items()
        if result.get("shutter_s") is not None
    ]


def facts_of(blur: Mapping[str, Any], preprocess: Mapping[str, Any]) -> list[str]:
    """How the scene was made, in a few words each; nothing of what was not measured."""
    facts = []
    frames = preprocess.get("frames") or {}
    if frames.get("train"):
        facts.append(f"{frames['train']} frames train, {frames.get('validation', 0)} validate")
    if frames.get("without_person"):
        facts.append(f"{frames['without_person']} frames without a person left out")
    exposure = look_up(blur, ("exposure_ms",))
    if exposure is not None:
        facts.append(f"shutter open for {exposure:.0f} ms")
    if blur.get("window"):
        space = _SPACES.get(str(blur.get("averaging_space")), "")
        facts.append(f"{blur['window']} sub-frames averaged{f' as {space}' if space else ''}")
    guessed = look_up(blur, ("interpolation", "psnr_person"))
    where = " on the person"
    if guessed is None:
        guessed, where = look_up(blur, ("interpolation", "psnr")), ""
    if guessed is not None:
        facts.append(f"interpolated frames match held-out ones at {guessed:.1f} dB{where}")
    made = look_up(blur, ("blur", "psnr_person"))
    if made is not None:
        facts.append(f"the blur made of them matches the true blur at {made:.1f} dB")
    return facts


def _pictures(results: Mapping[str, Mapping[str, Any]]) -> str:
    counts = {
        int(count)
        for result in results.values()
        if (count := look_up(result, ("counts", "novel_views"))) is not None
    }
    return f"Means over {' or '.join(map(str, sorted(counts)))} pictures." if counts else ""


def _camera_columns(results: Mapping[str, Mapping[str, Any]]) -> list[Column]:
    """Two columns for every test camera, if there are few enough to be shown apart."""
    names = dict.fromkeys(name for r in results.values() for name in r.get("cameras") or {})
    if not 1 < len(names) <= 4:
        return []
    labels = {HEADLINE: "", "psnr_foreground": ", person"}
    return [
        replace(column, path=("cameras", name, *column.path[1:]), label=f"{name}{label}")
        for name in names
        for column, label in zip(image_columns("", list(labels)), labels.values(), strict=True)
    ]


def _aligned_columns(results: Mapping[str, Mapping[str, Any]]) -> list[Column]:
    """PSNR of the seen surface before and after alignment, and the body's overlap, by camera."""
    names = dict.fromkeys(name for r in results.values() for name in r.get("body_iou") or {})
    columns: list[Column] = []
    for name in names:
        raw, *_ = image_columns("", ["psnr_seen"])
        columns += [
            replace(raw, path=("cameras", name, "psnr_seen"), label=f"{name} seen"),
            replace(
                raw,
                path=("color_aligned", "cameras", name, "psnr_seen"),
                label=f"{name} seen, aligned",
            ),
            Column(("body_iou", name), f"{name} body", "IoU", 2, 1),
        ]
    return columns


def _with_start(results: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """The methods, and the poses they started from as a row of its own."""
    start = next((r["initial"] for r in results.values() if r.get("initial")), None)
    rows: dict[str, Mapping[str, Any]] = {START: {"motion": start}} if start else {}
    return {**rows, **results}
