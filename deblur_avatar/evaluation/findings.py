"""Findings of a check: one number each, its verdict, and what to do about it.

Verdicts are `ok`, `warn`, `fail`, and `unknown` where the number could not be measured.
"""

import logging
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from deblur_avatar.errors import ArtifactError
from deblur_avatar.files import read_json

logger = logging.getLogger(__name__)

# Findings about the worst part of the body: where a check lists the parts, and which is the worst.
_WORST_PART = {"worst_part_inside": ("parts", min), "worst_part_open": ("open", max)}
_BONES = {"shoulder": "upper arm", "elbow": "forearm", "hip": "thigh", "knee": "shin"}


@dataclass(frozen=True)
class Finding:
    """One number, what it means and what to do about it."""

    value: float | None
    unit: str
    verdict: str
    advice: str


class _Written(BaseModel):
    """What a check's file holds, as far as it is told of."""

    findings: dict[str, Finding]
    parts: dict[str, float | None] = {}
    open: dict[str, float | None] = {}


class Scale(NamedTuple):
    """Up to which values a finding is ok, and from which it fails; a fall is worse if ok > fail."""

    ok: float
    fail: float | None  # None: never worse than a warning, and low values are the bad ones
    unit: str
    advice: str


def judged(scale: Scale, value: float | None) -> Finding:
    """Give a number its verdict and advice; what is no number (NaN) fails, as nothing passes it."""
    if value is None:
        return Finding(None, scale.unit, "unknown", "")
    if math.isnan(value):
        return Finding(None, scale.unit, "fail", scale.advice)
    rising = scale.fail is not None and scale.fail > scale.ok
    falls = not rising
    good = value >= scale.ok if falls else value <= scale.ok
    if good:
        return Finding(value, scale.unit, "ok", "")
    bad = scale.fail is not None and (value < scale.fail if falls else value > scale.fail)
    return Finding(value, scale.unit, "fail" if bad else "warn", scale.advice)


def worst(verdicts: Iterable[str]) -> str:
    """`fail` before `warn` before `ok`; `unknown` where nothing could be measured."""
    given = set(verdicts)
    return next((verdict for verdict in ("fail", "warn", "ok") if verdict in given), "unknown")


def tell(what: str, content: Mapping[str, Any]) -> None:
    """Log the findings of `what`, loudly where they are bad."""
    for name, finding in content["findings"].items():
        if finding["verdict"] in ("warn", "fail"):
            logger.warning(
                "%s %s: %s %s %s. %s", finding["verdict"].upper(), what, _subject(name, content),
                _said(finding["value"], 3), finding["unit"], finding["advice"],
            )  # fmt: skip
    logger.info("check %s: %s", what, content["verdict"])


def failures(content: Mapping[str, Any]) -> list[str]:
    """What failed, a sentence each: the finding, its number, what to do."""
    return [
        f"{_subject(name, content).capitalize()}: {_said(finding['value'], 2)} "
        f"({finding['unit']}). {finding['advice']}"
        for name, finding in content["findings"].items()
        if finding["verdict"] == "fail"
    ]


def failed_checks(
    metrics: Path, scenes: Iterable[str], runs: Iterable[str]
) -> dict[str, list[str]]:
    """What failed of scenes before fitting and of avatars after it, by what to think of each.

    Args:
        metrics: holds `check/<scene>.json` and `self_check/<run>.json`; those not made are no
            failures.
        scenes: by name.
        runs: by name.

    Raises:
        ArtifactError: if a file is damaged.
    """
    told = [
        ("check", "look before you trust what it shows", scenes),
        ("self_check", "do not trust what it shows", runs),
    ]
    failed = {}
    for kind, advice, names in told:
        for name in names:
            path = metrics / kind / f"{name}.json"
            if path.exists() and (sentences := failures(read_findings(path))):
                failed[f"{name} fails its {kind.replace('_', '-')}; {advice}"] = sentences
    return failed


def _subject(name: str, content: Mapping[str, Any]) -> str:
    """A finding's name in words, with the part of the body that it is about."""
    words = name.replace("_", " ")
    listed, choose = _WORST_PART.get(name, ("", max))
    parts = {n: share for n, share in content.get(listed, {}).items() if share is not None}
    if not parts:
        return words
    side, _, bone = choose(parts, key=parts.__getitem__).partition("_")
    return f"{words} ({' '.join(filter(None, (side, _BONES.get(bone, bone))))})"


def _said(value: float | None, digits: int) -> str:
    return "no number" if value is None else f"{value:.{digits}g}"


def read_findings(path: Path) -> dict[str, Any]:
    """What a check wrote.

    Raises:
        ArtifactError: if the file is missing or damaged.
    """
    content = read_json(path)
    try:
        _Written.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ArtifactError(
            f"{path} is damaged: {where}: {first['msg']}; run `dvc repro`"
        ) from None
    return content
