"""Confusion table of the self-check: avatars known to be good or damaged, and what it says of them.

Good avatars are fits of the suite's scenes as they are. Damaged ones come of damaged input
(`damage.py`), of a fit that was spoilt or cut short. A damage here is gross: whoever looks at the
avatar sees it. Thresholds were chosen on the `tuning` scenes; the others were looked at afterwards.
"""

import dataclasses
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import torch

from benchmarks.stress.fit import FitSetup, fit_method, lengthened
from benchmarks.stress.input import prepare
from benchmarks.stress.measures import measure
from benchmarks.stress.params import SelfCheckParams
from benchmarks.stress.suite import LoadScene
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.bodies.capsule import capsule_body
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.pipeline.self_check import self_check

logger = logging.getLogger(__name__)

Spoil = Callable[[Avatar, float], Avatar]


def _scattered(avatar: Avatar, amount: float) -> Avatar:
    """This share of the Gaussians flies about the room."""
    means = avatar.means.clone()
    count = round(amount * len(means))
    generator = torch.Generator().manual_seed(0)
    means[:count] += torch.randn(count, 3, generator=generator) * 0.5
    return dataclasses.replace(avatar, means=means)


def _inflated(avatar: Avatar, amount: float) -> Avatar:
    """Every Gaussian is so many times as large."""
    grown = avatar.log_scales + torch.tensor(amount).log()
    return dataclasses.replace(avatar, log_scales=grown)


def _inverted(avatar: Avatar, amount: float) -> Avatar:
    """The colours of somebody else."""
    return dataclasses.replace(avatar, features=-amount * avatar.features)


SPOILT: dict[str, Spoil] = {
    "scattered_share": _scattered,
    "inflated_times": _inflated,
    "inverted": _inverted,
}
CUT_SHORT = "budget"  # times the schedule's iterations


@dataclass(frozen=True)
class Case:
    """One fit, and what is wrong with it: the name of a damage and its amount, or nothing."""

    scene: str
    method: str
    damage: str | None
    amount: float
    tuning: bool

    @property
    def name(self) -> str:
        """As the table shows it."""
        return f"{self.scene}-{self.method}-{self.damage or 'good'}"


def cases_of(params: SelfCheckParams) -> Iterator[Case]:
    """All cases, good ones first; each method's damages go round the scenes."""
    scenes = [(name, True) for name in params.tuning] + [(name, False) for name in params.report]
    for scene, tuning in scenes:
        for method in params.methods:
            yield Case(scene, method, None, 0.0, tuning)
    for tuning, names in ((True, params.tuning), (False, params.report)):
        ruined = [(m, *damage) for m in params.methods for damage in params.damages.items()]
        for index, (method, damage, amount) in enumerate(ruined):
            yield Case(names[index % len(names)], method, damage, amount, tuning)


def judge_case(case: Case, setup: FitSetup, load_scene: LoadScene) -> dict[str, Any]:
    """Fit one case and let the avatar judge itself.

    Returns:
        The verdict, the findings that are not ok, and the PSNR (dB) of test views of the person;
        a case that the pipeline refuses has the verdict `refused`, which counts as caught.
    """
    clip, reference = load_scene(case.scene)
    spoilt = case.damage in SPOILT
    cut_short = case.damage == CUT_SHORT
    asked = {} if case.damage is None or spoilt or cut_short else {case.damage: case.amount}
    if cut_short:
        setup = dataclasses.replace(setup, schedule=lengthened(setup.schedule, case.amount))
    row = {"name": case.name, **dataclasses.asdict(case), "good": case.damage is None}
    try:
        prepared = prepare(
            clip, capsule_body(), asked, setup.schedule.image_height, setup.validation_stride,
            setup.seed,
        )  # fmt: skip
        fitted = fit_method(prepared.blurred, setup, setup.plain)
    except (ConfigError, ArtifactError) as error:
        return row | {"verdict": "refused", "why": str(error), "findings": {}, "score": None}
    if spoilt and case.damage is not None:
        avatar = SPOILT[case.damage](fitted.avatar, case.amount)
        fitted = dataclasses.replace(fitted, avatar=avatar)
    content = self_check(prepared.blurred, fitted.avatar, fitted.motion, setup.device).content
    measured = measure(prepared.blurred, reference, fitted, setup.device)
    told = {
        name: {"value": finding["value"], "verdict": finding["verdict"]}
        for name, finding in content["findings"].items()
    }
    logger.info("%s: %s, %.2f dB", case.name, content["verdict"], measured.numbers["score"])
    row |= {"verdict": content["verdict"], "findings": told}
    return row | {"score": measured.numbers["score"]}


def confusion(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The table: how many are good and damaged, and how many the self-check got wrong.

    A gross miss is a damaged avatar that does not fail; a false alarm a good one that does.
    """

    def counted(chosen: list[dict[str, Any]]) -> dict[str, int]:
        good = [row for row in chosen if row["good"]]
        damaged = [row for row in chosen if not row["good"]]
        return {
            "good": len(good),
            "damaged": len(damaged),
            "gross_misses": sum(row["verdict"] not in ("fail", "refused") for row in damaged),
            "false_alarms": sum(row["verdict"] == "fail" for row in good),
        }

    report = [row for row in rows if not row["tuning"]]
    return {**counted(rows), "not_tuned_on": counted(report), "cases": rows}
