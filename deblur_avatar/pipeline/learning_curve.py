"""The learning curve: how good the avatars are that fitting kept on its way.

Every snapshot of every method on a scene is compared with the same few test views and the same
frames set aside. When each was taken is what fitting measured with a clock, which the report adds.
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
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.evaluation.comparisons import compare_views, mean_scores
from deblur_avatar.evaluation.metrics import recovered_metrics
from deblur_avatar.evaluation.reblur import mean_reblur_psnr
from deblur_avatar.evaluation.truth_views import TruthView, truth_views
from deblur_avatar.geometry.spacing import evenly_spaced

VIEWS = (
    12  # test views that each snapshot is compared with, evenly spaced over cameras and instants
)


@dataclass(frozen=True)
class Moment:
    """An avatar on the way: where it lies and at which iteration it was there."""

    stage: str
    iteration: int
    folder: Path  # of `avatar` and `motion`


def learning_curve(
    observations: Observations,
    reference: Reference,
    stages: Mapping[str, Path],
    device: torch.device,
) -> dict[str, Any]:
    """Score every snapshot of one run.

    Args:
        observations: the blurred ones, whatever the run was fitted to.
        reference: sharp test views; without any only frames set aside are scored.
        stages: what each fitting stage of the run wrote, by its name.
        device: to render on.

    Raises:
        ArtifactError: if a snapshot is damaged.
    """
    novel = [view for view in truth_views(observations, reference) if not view.novel_pose]
    views = evenly_spaced(novel, VIEWS)
    moments = moments_of(stages)
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


def moments_of(stages: Mapping[str, Path]) -> list[Moment]:
    """The snapshots of all stages in their order, and the end of each that kept none on the way.

    A warm-up without snapshots has no motion to be seen in, and is left out.
    """
    moments: list[Moment] = []
    for stage, folder in stages.items():
        kept = sorted((folder / "snapshots").glob("[0-9]*"))
        moments += [Moment(stage, int(path.name), path) for path in kept]
        if not kept and (folder / "motion").exists():
            last = Avatar.load(folder / "avatar").iteration
            moments.append(Moment(stage, last, folder))
    return moments


def _scored(
    moment: Moment,
    observations: Observations,
    reference: Reference,
    views: Sequence[TruthView],
    device: torch.device,
) -> dict[str, Any]:
    avatar, motion = Avatar.load(moment.folder / "avatar"), Motion.load(moment.folder / "motion")
    model = avatar_from_artifact(avatar, observations.body, device)
    scores = mean_scores(compare_views(model, observations, reference, motion, views))
    return {
        "stage": moment.stage,
        "iteration": moment.iteration,
        "gaussians": len(avatar.means),
        "image": scores and {row.name: scores[row.name] for row in recovered_metrics()},
        "validation_psnr": mean_reblur_psnr(model, observations, motion, observations.validation),
    }


def _size_mb(folder: Path) -> float:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6
