"""Which tables the page shows of one scene, and the facts above them.

Conventions. Results are contents of metrics files by method; `blur` and `preprocess` are those of
the stages of these names. A table whose numbers nobody measured is left out.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from deblur_avatar.reporting.results_table import (
    BOUNDS,
    COST,
    EXPLAINED,
    LPIPS,
    NOVEL_VIEW,
    PSNR,
    START,
    Column,
    Table,
    look_up,
    measured,
    results_table,
)

NOT_KNOWN = "not known"

NOVEL_POSE = tuple(
    Column(("novel_pose", metric), label, unit, digits, better)
    for metric, label, unit, digits, better in (
        ("psnr", "PSNR", "dB", 2, 1), ("ssim", "SSIM", "", 3, 1), ("flip", "FLIP", "", 3, -1),
        ("psnr_foreground", "PSNR person", "dB", 2, 1), ("psnr_seen", "PSNR seen", "dB", 2, 1),
        ("flip_seen", "FLIP seen", "", 3, -1),
    )
)  # fmt: skip
MOTION = (
    Column(("motion", "joint_error_mm"), "joints", "mm", 1, -1),
    Column(("motion", "surface_error_mm"), "surface", "mm", 1, -1),
    Column(("motion", "joint_error_deg"), "joint angles", "degrees", 2, -1),
    Column(("motion", "travel_error_mm"), "travel in exposure", "mm", 1, -1),
    Column(("motion", "direction_accuracy"), "right direction", "%", 0, 1, factor=100.0),
    EXPLAINED,
)
WITHOUT_TRUTH = (EXPLAINED, Column(("reblur", "psnr_train"), "those trained on", "dB", 2, 1))
FIT = (
    Column(("reprojection_px",), "landmarks, median", "pixels", 1),
    Column(("iou",), "silhouette overlap", "IoU", 3),
)


@dataclass(frozen=True)
class Titled:
    """A table with what stands above and below it."""

    title: str
    table: Table
    note: str = ""


def tables_of(
    results: Mapping[str, Mapping[str, Any]], preprocess: Mapping[str, Any]
) -> list[Titled]:
    """The tables of one scene, in the order of the page."""
    tables = [_novel_views(results) if measured(results, [PSNR]) else _explained(results)]
    if measured(results, NOVEL_POSE):
        note = "The last part of the clip, which no method was trained on."
        table = results_table(results, measured(results, NOVEL_POSE))
        tables.append(Titled("Novel poses", table, note))
    cameras = _camera_columns(results)
    if cameras:
        note = "PSNR over all pixels, and over the person."
        tables.append(Titled("Camera by camera", results_table(results, cameras), note))
    if measured(results, MOTION[:-1]):
        table = results_table(
            _with_start(results), MOTION, missing=NOT_KNOWN, bounds=(*BOUNDS, START)
        )
        note = "In italics besides: the poses that every method starts from."
        tables.append(Titled("Motion against the truth", table, note))
    if measured(results, COST):
        note = "Training counts the warm-up in full, though methods may share it."
        table = results_table(results, measured(results, COST), missing=NOT_KNOWN)
        tables.append(Titled("Cost", table, note))
    fit = {name: entry for name, entry in (preprocess.get("fit") or {}).items() if entry}
    if fit:
        tables.append(
            Titled(
                "How well the estimated body explains each camera",
                results_table(fit, FIT, of="camera"),
                "Estimated from the blurred frames.",
            )
        )
    return tables


def _novel_views(results: Mapping[str, Mapping[str, Any]]) -> Titled:
    # Perceptual distance stays even where nobody could measure it: readers look for it.
    views = tuple(c for c in NOVEL_VIEW if c is LPIPS or measured(results, [c]))
    return Titled("Novel views", results_table(results, views), _pictures(results))


def _explained(results: Mapping[str, Mapping[str, Any]]) -> Titled:
    note = (
        "This footage has no sharp truth. Blurred frames that were set aside are compared with "
        "the avatar's renders averaged over the exposure (PSNR)."
    )
    return Titled("Blurred frames explained", results_table(results, WITHOUT_TRUTH), note)


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
        light = {"srgb": "sRGB values", "linear": "linear light"}.get(str(blur.get("light")), "")
        facts.append(f"{blur['window']} sub-frames averaged{f' as {light}' if light else ''}")
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
    return [
        Column(("cameras", name, metric), f"{name}{word}", "dB", 2, 1)
        for name in names
        for metric, word in (("psnr", ""), ("psnr_foreground", ", person"))
    ]


def _with_start(results: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """The methods, and the poses they started from as a row of its own."""
    start = next((r["initial"] for r in results.values() if r.get("initial")), None)
    rows: dict[str, Mapping[str, Any]] = {START: {"motion": start}} if start else {}
    return {**rows, **results}
