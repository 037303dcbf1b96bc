"""Stage `self_check`: whether a fitted avatar is usable, judged by itself, without ground truth.

The second part of the check: `check` asks before training whether the scene is fit for it, this
asks afterwards whether the avatar is one person, and the one that was filmed.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.evaluation.avatar_measures import (
    FRAMES,
    Look,
    coverage_iou,
    explained_share,
    far_share,
    filmed_looks,
    outside_share,
    own_explained_share,
    parts_inside,
    turntable,
)
from deblur_avatar.evaluation.findings import Finding, Scale, judged, worst
from deblur_avatar.evaluation.surface_quality import clothes_share, fur_share
from deblur_avatar.evaluation.torn_parts import parts_open
from deblur_avatar.geometry.spacing import evenly_spaced

_SURROUNDINGS = (
    "The avatar holds something that is not the person: look at masks and background "
    "(preprocess.background: auto), at people beside and objects in the hands."
)
_SCALES = {
    "outside_filmed": Scale(0.02, 0.1, "share of its light", _SURROUNDINGS),
    "outside_turntable": Scale(
        0.03, 0.12, "share of its light",
        "Seen from other sides the avatar spreads beyond the person: let the person turn, use a "
        "longer schedule, look at the poses in check.png.",
    ),
    "fur_share": Scale(
        0.06, 0.15, "share of its light",
        "Seen from other sides light stands more than 5 cm off the body. Wide clothes and long "
        "hair do that, and so does a haze of Gaussians: look at self_check.png, let the person "
        "turn.",
    ),
    "far_gaussians": Scale(
        0.02, 0.1, "share of its opacity",
        "Gaussians stand more than 15 cm off the body. " + _SURROUNDINGS,
    ),
    "coverage_iou": Scale(
        0.75, 0.5, "IoU with the masks",
        "The avatar does not fill the person's masks: poses, focal length or masks are wrong.",
    ),
    "explained_share": Scale(
        0.6, 0.3, "share of the variance",
        "The avatar does not look like the frames set aside: poses or masks are wrong, the motion "
        "is too fast, or the schedule is too short.",
    ),
    "worst_part_inside": Scale(
        0.75, 0.4, "share of the part",
        "A limb lies where the masks show nobody, so its motion cannot be believed: bring "
        "keypoints of a better detector, or poses.",
    ),
    "worst_part_open": Scale(
        0.1, 0.5, "share of the part",
        "A limb or the head is torn: one sees through it. Its motion or its masks are wrong, or no "
        "frame shows enough of it: look at check.png, let the person turn.",
    ),
    "seen_share": Scale(
        0.5, None, "share of the surface",
        "The rest was never seen by the camera and is made up: let the person turn.",
    ),
}  # fmt: skip

_EDGES = (
    "Of her own colours enough is explained; her edges, before a background that is unlike her, "
    "are a pixel or two off, or the masks hold some of it."
)
_WIDE = "Masks show as much: clothes are wide, or masks, poses or the focal length are wrong."


@dataclass(frozen=True, eq=False)
class SelfCheck:
    """The findings, and the pictures they were read off."""

    content: dict[str, Any]
    filmed: dict[int, Look]  # by position
    sides: list[Look]


def self_check(
    observations: Observations, avatar: Avatar, motion: Motion, device: torch.device
) -> SelfCheck:
    """Judge one fitted avatar.

    Args:
        observations: the blurred ones that it was fitted to.
        avatar: fitted.
        motion: of every exposure.
        device: to render on.

    Returns:
        As `content`: the worst `verdict`, the `findings` by name, `parts`: the share of each limb
        that the masks confirm, and `open`: of each that one sees through.
    """
    model = avatar_from_artifact(avatar, observations.body, device)
    trained = evenly_spaced(observations.train, FRAMES)
    aside = evenly_spaced(observations.validation or observations.train, FRAMES)
    filmed = filmed_looks(model, observations, motion, trained)
    explained = filmed_looks(model, observations, motion, aside)
    sides = turntable(model, observations, motion)
    parts = parts_inside(observations, motion, trained)
    middle = observations.train[len(observations.train) // 2]
    torn = parts_open(model, motion, middle)
    values = {
        "outside_filmed": outside_share(filmed),
        "outside_turntable": outside_share(sides),
        "fur_share": fur_share(sides),
        "far_gaussians": far_share(model),
        "coverage_iou": coverage_iou(observations, filmed, trained),
        "explained_share": explained_share(observations, explained, aside),
        "worst_part_inside": min(parts.values(), default=None),
        "worst_part_open": max(torn.values(), default=None),
        "seen_share": 1 - observations.occluded_fraction,
    }
    findings = {name: judged(_SCALES[name], value) for name, value in values.items()}
    clothes = partial(clothes_share, observations, filmed, trained)
    findings["fur_share"] = _unless_wide(findings["fur_share"], clothes)
    own = partial(own_explained_share, observations, explained, aside)
    findings["explained_share"] = _unless_edges(findings, own)
    content = {
        "verdict": worst(finding.verdict for finding in findings.values()),
        "findings": {name: vars(finding) for name, finding in findings.items()},
        "parts": parts,
        "open": torn,
    }
    return SelfCheck(content, dict(zip(trained, filmed, strict=True)), sides)


def _unless_wide(fur: Finding, clothes: Callable[[], float]) -> Finding:
    """Fur, a warning at worst where what exceeds the masks' share is ok."""
    if fur.verdict != "fail" or fur.value is None:
        return fur
    if judged(_SCALES["fur_share"], fur.value - clothes()).verdict != "ok":
        return fur
    return replace(fur, verdict="warn", advice=f"{_WIDE} {fur.advice}")


def _unless_edges(findings: Mapping[str, Finding], own: Callable[[], float | None]) -> Finding:
    """What is explained, a warning at worst where mattes are filled and own colours explained.

    Somebody dark before a bright window varies less in all of her than at an edge a pixel off.
    """
    found = findings["explained_share"]
    if found.verdict != "fail" or findings["coverage_iou"].verdict != "ok":
        return found
    share = own()
    if share is None or judged(_SCALES["explained_share"], share).verdict == "fail":
        return found
    return replace(found, verdict="warn", advice=f"{_EDGES} {found.advice}")
