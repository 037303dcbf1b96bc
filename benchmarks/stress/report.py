"""The stress report: rules applied to what was measured, on one page.

Measuring and judging are apart, so that a changed rule costs seconds. A mode is passed if every
severity is. A severity that does not apply to a method, or changed not one byte of its avatar,
counts for nothing; nor does a mode of which none counts.
"""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.stress.checks import AGNOSTIC, Case, Check
from benchmarks.stress.params import ModeParams, SeverityParams
from benchmarks.stress.rules import judge
from benchmarks.stress.suite import PICTURES
from deblur_avatar.errors import ArtifactError
from deblur_avatar.files import read_json, write_json, write_text
from deblur_avatar.imaging.contact_sheets import contact_sheet
from deblur_avatar.imaging.picture_files import read_picture
from deblur_avatar.reporting.page import picture_uri, render_page
from deblur_avatar.reporting.picture_strips import (
    Picture,
    person_box,
)
from deblur_avatar.reporting.results_table import Cell, Column, Table

TEMPLATE = Path(__file__).parent / "report.html.jinja"
CLEAN = "seeds"  # the mode of the scene that nothing is wrong with, and its severities:
CLEAN_SEVERITIES = {"plain": "clean", "networks": "clean, networks"}  # by avatar
HARMLESS = {"networks", "draws", "seed", "no_oracle", "blend", "instants"}  # ways to ask for a fit
DARKEST, BRIGHTEST = 8.0, 19.0  # dB between which the heat map's colours run
ENLARGED = 2  # times, of the worst pictures

Rows = Mapping[str, Mapping[str, Mapping[str, Mapping[str, Any]]]]  # mode, method, severity


@dataclass(frozen=True)
class Verdict:
    """How one method did in one mode."""

    passed: bool | None  # None: no severity counts
    sentence: str
    severities: dict[str, dict[str, Any]]  # score, draws, passed (None: does not apply), checks


@dataclass(frozen=True)
class StabilityReport:
    """All verdicts, the page, and the numbers for other programs."""

    page: str
    summary: dict[str, Any]
    metrics: dict[str, dict[str, Any]]  # by "<mode>-<method>"

    def save(self, reports: Path, metrics: Path) -> None:
        """Write `index.html` and `stability.json`, and one file a mode and method."""
        write_text(reports / "index.html", self.page)
        write_json(reports / "stability.json", self.summary)
        for name, content in self.metrics.items():
            write_json(metrics / f"{name}.json", content)


def report_stability(modes: Mapping[str, ModeParams], items: Path, scenes: Path) -> StabilityReport:
    """Judge every mode and method that was measured.

    Args:
        modes: of the suite.
        items: where `<mode>-<method>/measured.json` are.
        scenes: where `<scene>/ceiling.json` are.

    Raises:
        ArtifactError: if nothing was measured, or not what the rules compare with.
    """
    rows, methods = _read(modes, items)
    names = {s.scene for mode in rows for s in modes[mode].severities.values()}
    ceilings = {name: read_json(scenes / name / "ceiling.json") for name in sorted(names)}
    verdicts = {
        mode: {method: _verdict(mode, modes[mode], method, rows, ceilings) for method in rows[mode]}
        for mode in rows
    }
    summary = _summary(modes, verdicts, rows, methods)
    metrics = {
        f"{mode}-{method}": {"mode": mode, "method": method, **vars(verdict)}
        for mode, of_methods in verdicts.items()
        for method, verdict in of_methods.items()
    }
    page = _page(modes, verdicts, summary, methods, ceilings, items)
    return StabilityReport(page, summary, metrics)


def _read(modes: Mapping[str, ModeParams], items: Path) -> tuple[Rows, list[str]]:
    """What there is of each mode, `agnostic` first; modes without it cannot be judged."""
    rows: dict[str, dict[str, Any]] = {}
    for mode in modes:
        folders = sorted(items.glob(f"{mode}-*/measured.json"))
        found = {path.parent.name.removeprefix(f"{mode}-"): read_json(path) for path in folders}
        if AGNOSTIC in found:
            rows[mode] = found
    if CLEAN not in rows:
        raise ArtifactError(
            f"no {CLEAN}-{AGNOSTIC} in {items}, which rules compare with; "
            "run `dvc repro stability/dvc.yaml`"
        )
    known = {method for found in rows.values() for method in found}
    return rows, [AGNOSTIC, *sorted(known - {AGNOSTIC}, reverse=True)]


def _verdict(
    mode: str,
    params: ModeParams,
    method: str,
    rows: Rows,
    ceilings: Mapping[str, Mapping[str, Any]],
) -> Verdict:
    of_severities: dict[str, dict[str, Any]] = {}
    before: dict[str, list[Mapping[str, Any]]] = {avatar: [] for avatar in CLEAN_SEVERITIES}
    for label, severity in params.severities.items():
        row = rows[mode][method].get(label)
        if row is None:
            raise ArtifactError(f"{mode}-{method} lacks {label!r}; run `dvc repro`")
        avatar = "networks" if "networks" in severity.fit else "plain"
        clean = rows[CLEAN].get(method, {}).get(CLEAN_SEVERITIES[avatar], {})
        skipped = row.get("skipped") or _changed_nothing(severity, row, clean)
        if skipped:
            of_severities[label] = {"score": None, "passed": None, "checks": [skipped]}
            continue
        case = Case(
            method=method, severity=severity, row=row,
            agnostic=_agnostic(rows, mode, label, severity, avatar),
            ceiling=ceilings[severity.scene][avatar], clean=clean,
            clean_ceiling=_clean_ceiling(clean, ceilings, avatar),
            before=tuple(before[avatar]),
        )  # fmt: skip
        of_severities[label] = _judged(judge(mode, case), case)
        before[avatar].append(row)
    return _concluded(of_severities)


def _agnostic(
    rows: Rows, mode: str, label: str, severity: SeverityParams, avatar: str
) -> Mapping[str, Any]:
    """What `agnostic` made of a severity; of the clean scene, where fitting alone is disturbed in a
    way that is nothing to it.
    """
    row = rows[mode][AGNOSTIC].get(label, {})
    if "skipped" in row and not severity.damage:
        return rows[CLEAN][AGNOSTIC].get(CLEAN_SEVERITIES[avatar], {})
    return row


def _clean_ceiling(
    clean: Mapping[str, Any], ceilings: Mapping[str, Mapping[str, Any]], avatar: str
) -> Mapping[str, Any]:
    """The ceiling of the scene that a method's clean row is of; nothing without such a row."""
    return ceilings[clean["scene"]][avatar] if clean else {}


def _changed_nothing(
    severity: SeverityParams, row: Mapping[str, Any], clean: Mapping[str, Any]
) -> str | None:
    """Why a severity that would do harm tells nothing: the avatar is the clean scene's."""
    does_harm = severity.damage or set(severity.fit) - HARMLESS
    digest = row.get("digest")
    if not does_harm or digest is None or digest != clean.get("digest"):
        return None
    return "this changed nothing: the avatar is the clean scene's, byte for byte"


def _judged(checks: Sequence[Check], case: Case) -> dict[str, Any]:
    passed = all(check.passed for check in checks)
    return {
        "score": case.score,
        "passed": passed,
        "agnostic": case.agnostic.get("score"),
        "ceiling": case.ceiling["score"],
        "draws": case.row.get("scores", []),
        "refused": case.row.get("refused"),
        "failed": [check.sentence for check in checks if not check.passed],
        "checks": [vars(check) | {"passed": check.passed} for check in checks],
    }


def _concluded(severities: dict[str, dict[str, Any]]) -> Verdict:
    """The mode as a whole, in one sentence."""
    failed = {label: entry for label, entry in severities.items() if entry["passed"] is False}
    if all(entry["passed"] is None for entry in severities.values()):
        return Verdict(None, "Does not apply.", severities)
    if not failed:
        return Verdict(True, "Passes at every severity.", severities)
    told = "; ".join(f"at {label}, {entry['failed'][0]}" for label, entry in failed.items())
    return Verdict(False, f"Fails {told}.", severities)


def _summary(
    modes: Mapping[str, ModeParams],
    verdicts: Mapping[str, Mapping[str, Verdict]],
    rows: Rows,
    methods: Sequence[str],
) -> dict[str, Any]:
    judged = {
        method: [of[method].passed for of in verdicts.values() if method in of]
        for method in methods
    }
    lost = {
        method: [m for m, of in verdicts.items()
                 if method in of and of[AGNOSTIC].passed and of[method].passed is False]
        for method in methods
    }  # fmt: skip
    return {
        "modes": len(verdicts),
        "passed": {method: found.count(True) for method, found in judged.items()},
        "does_not_apply": {method: found.count(None) for method, found in judged.items()},
        "failed_though_agnostic_passes": lost,
        "spread_over_seeds_db": {
            method: _spread(rows[CLEAN].get(method, {})) for method in methods
        },
        "verdicts": {
            mode: {
                "title": modes[mode].title,
                **{method: vars(verdict) for method, verdict in of.items()},
            }
            for mode, of in verdicts.items()
        },
    }


def _spread(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, float | None]:
    """Mean and standard deviation of the clean scene's score over draws, without networks."""
    shown = [row for label, row in rows.items() if label != CLEAN_SEVERITIES["networks"]]
    scores = list(dict.fromkeys(score for row in shown for score in row.get("scores", ())))
    return {
        "mean": statistics.mean(scores) if scores else None,
        "deviation": statistics.stdev(scores) if len(scores) > 1 else None,
        "seeds": float(len(scores)),
    }


def _page(
    modes: Mapping[str, ModeParams],
    verdicts: Mapping[str, Mapping[str, Verdict]],
    summary: Mapping[str, Any],
    methods: Sequence[str],
    ceilings: Mapping[str, Mapping[str, Any]],
    items: Path,
) -> str:
    shown = [
        {
            "name": mode,
            "title": modes[mode].title,
            "of": of,
            "rows": [
                {
                    "label": label,
                    "cells": [_cell(of[method].severities[label]) if method in of else None
                              for method in methods],
                    "ceiling": _shown_ceiling(ceilings[severity.scene], severity),
                }
                for label, severity in modes[mode].severities.items()
            ],
            "picture": _picture(mode, [m for m in methods if m in of], items),
        }
        for mode, of in verdicts.items()
    ]  # fmt: skip
    headline = _headline(summary, methods)
    return render_page(TEMPLATE, modes=shown, summary=summary, methods=methods, headline=headline)


def _shown_ceiling(ceilings: Mapping[str, Any], severity: SeverityParams) -> float:
    score: float = ceilings["networks" if "networks" in severity.fit else "plain"]["score"]
    return score


def _headline(summary: Mapping[str, Any], methods: Sequence[str]) -> Table:
    rows = {
        f"modes passed, of {summary['modes']}": lambda m: str(summary["passed"][m]),
        "do not apply": lambda m: str(summary["does_not_apply"][m]),
        "failed, though agnostic passes": lambda m: str(
            len(summary["failed_though_agnostic_passes"][m])
        ),
        "clean scene, dB, mean \u00b1 spread over seeds": lambda m: _with_deviation(
            **summary["spread_over_seeds_db"][m]
        ),
    }
    return Table(
        columns=tuple(Column((), method) for method in methods),
        rows=tuple((name, tuple(Cell(of(m)) for m in methods)) for name, of in rows.items()),
    )


def _with_deviation(mean: float | None, deviation: float | None, seeds: float) -> str:
    if mean is None:
        return "\u2013"
    return f"{mean:.2f}" + (f" \u00b1 {deviation:.2f}" if deviation is not None else "")


def _cell(entry: Mapping[str, Any]) -> dict[str, Any]:
    """A field of the heat map: green or red, the darker the lower the score."""
    passed, score = entry["passed"], entry["score"]
    if passed is None:
        return {"text": "\u2013", "colour": "#eeeeee", "hint": entry["checks"][0]}
    share = 0.0 if score is None else (score - DARKEST) / (BRIGHTEST - DARKEST)
    lightness = 62 + 26 * min(max(share, 0.0), 1.0)
    text = f"{score:.2f}" if score is not None else "refused" if entry["refused"] else "crashed"
    hint = "; ".join(Check(**{k: c[k] for k in ("what", "value", "minimum", "maximum")}).sentence
                     for c in entry["checks"])  # fmt: skip
    if entry["refused"]:
        hint = f"{entry['refused']}; {hint}"
    if len(entry["draws"]) > 1:
        deviation = statistics.stdev(entry["draws"])
        hint = f"mean of {len(entry['draws'])} draws, \u00b1 {deviation:.2f}; {hint}"
    hue = 120 if passed else 4
    mark = "" if passed else " \u2717"
    return {"text": text + mark, "colour": f"hsl({hue}, 55%, {lightness:.0f}%)", "hint": hint}


def _picture(mode: str, methods: Sequence[str], items: Path) -> str | None:
    """The worst view of each method, a row each: blurred, drawn, true."""
    rows = [m for m in methods if all((items / f"{mode}-{m}" / f"{n}.png").is_file()
                                      for n in PICTURES)]  # fmt: skip
    if not rows:
        return None
    images = [
        [read_picture(items / f"{mode}-{method}" / f"{name}.png") for name in PICTURES]
        for method in rows
    ]
    left, top, right, bottom = person_box([picture for row in images for picture in row])
    cut = [_enlarged(p[top:bottom, left:right]) for row in images for p in row]
    labels = [label for method in rows for label in ("what was filmed", method, "truth")]
    return picture_uri(contact_sheet(cut, len(PICTURES), labels))


def _enlarged(picture: Picture) -> Picture:
    larger = cv2.resize(picture, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_CUBIC)
    return np.asarray(larger, np.uint8)
