"""What each second of training bought: how good the avatars are that fitting kept on its way.

Seconds count from a run's first iteration over its three stages, the warm-up in full although
methods may share it; what writing snapshots took is not in them. Every snapshot of every method on
a scene is compared with the same few test views and the same frames set aside.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.avatars.model import AvatarModel
from deblur_avatar.config.runs import RunParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.comparisons import compare, mean_scores
from deblur_avatar.evaluation.costs import cost_files
from deblur_avatar.evaluation.reblur import mean_reblur_psnr
from deblur_avatar.evaluation.truth_views import TruthView, truth_views

VIEWS = 12  # test views that each snapshot is compared with, spread over cameras and instants
SCORES = ("psnr", "ssim", "flip", "lpips_vgg", "psnr_seen")


@dataclass(frozen=True)
class Moment:
    """An avatar on the way: where it lies and when in training it was there."""

    stage: str
    iteration: int
    seconds: float  # since the run began
    folder: Path  # of `avatar` and `motion`


def timeline(
    observations: Observations,
    reference: Reference,
    stages: Mapping[str, Path],
    costs: Path,
    params: RunParams,
    device: torch.device,
) -> dict[str, Any]:
    """Score every snapshot of one run.

    Args:
        observations: the blurred ones, whatever the run was fitted to.
        reference: sharp test views; without any only frames set aside are scored.
        stages: what each fitting stage of the run wrote, by its name.
        costs: where all metrics are.
        params: which run.
        device: to draw on.

    Raises:
        ArtifactError: if a stage's measurements or a snapshot are missing.
    """
    views = _spread(truth_views(observations, reference))
    moments = moments_of(stages, costs, params)
    points = [
        _scored(moment, observations, reference, views, device)
        for moment in run.progress(moments, "snapshots")
    ]
    return {
        "views": len(views),
        "validation": len(observations.validation),
        "disk_mb": _size_mb(stages["fusion"] / "avatar"),
        "points": points,
    }


def moments_of(stages: Mapping[str, Path], costs: Path, params: RunParams) -> list[Moment]:
    """The snapshots of all stages in the order of time, and the end of each that has a motion.

    Raises:
        ArtifactError: if what a stage measured is missing or damaged.
    """
    moments: list[Moment] = []
    before = 0.0
    for stage, path in cost_files(costs, params).items():
        content = run.read_json(path)
        try:
            seconds = _seconds(content)
            kept = [(int(s["iteration"]), _seconds(s)) for s in content["snapshots"]]
        except (KeyError, TypeError, ValueError) as error:
            raise ArtifactError(f"{path} is damaged: {error!r}; run `dvc repro`") from error
        for iteration, took in kept:
            folder = stages[stage] / "snapshots" / f"{iteration:06d}"
            moments.append(Moment(stage, iteration, before + took, folder))
        if not kept and (stages[stage] / "motion").exists():
            last = Avatar.load(stages[stage] / "avatar").iteration
            moments.append(Moment(stage, last, before + seconds, stages[stage]))
        before += seconds
    return moments


def _seconds(measured: Mapping[str, Any]) -> float:
    value = measured["seconds"]
    if not isinstance(value, int | float):
        raise TypeError(f"seconds is a {type(value).__name__}")
    return float(value)


def _scored(
    moment: Moment,
    observations: Observations,
    reference: Reference,
    views: Sequence[TruthView],
    device: torch.device,
) -> dict[str, Any]:
    avatar, motion = Avatar.load(moment.folder / "avatar"), Motion.load(moment.folder / "motion")
    model = AvatarModel.from_artifact(avatar, observations.body, device)
    scores = mean_scores(
        [compare(model, observations, reference, view, motion.centre) for view in views]
    )
    return {
        "stage": moment.stage,
        "iteration": moment.iteration,
        "seconds": moment.seconds,
        "gaussians": len(avatar.means),
        "image": scores and {name: scores[name] for name in SCORES},
        "validation_psnr": mean_reblur_psnr(model, observations, motion, observations.validation),
    }


def _spread(views: Sequence[TruthView]) -> list[TruthView]:
    """Some of the novel views, evenly over cameras and instants."""
    novel = [view for view in views if not view.novel_pose]
    steps = torch.linspace(0, len(novel) - 1, min(VIEWS, len(novel))).round().long().tolist()
    return [novel[step] for step in steps]


def _size_mb(folder: Path) -> float:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6
