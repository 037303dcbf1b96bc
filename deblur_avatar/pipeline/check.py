"""The self-check of a scene: whether it is fit for training, before an hour is spent on it.

Each finding is one number with a verdict and, unless all is well, a sentence of what to do. Pixels
are those of the observations; shares of the person's height are independent of how large the
pictures are.
"""

import math
from collections.abc import Mapping
from typing import Any, Literal

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.config.section import (
    Params,
)
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.findings import Scale, judged, worst
from deblur_avatar.evaluation.scene_measures import (
    background_light,
    blur_extent,
    comparable_share,
    coverage,
    cut_off_share,
    height_px,
    mask_body_iou,
    reprojection_share,
    saturated_share,
    seen_azimuths,
)


class CheckParams(Params):
    """What happens to a scene that fails its check."""

    on_failure: Literal["warn", "stop"]


_SCALES = {
    "training_frames": Scale(30, 8, "frames", "Film longer, or lower clip.stride."),
    "person_share": Scale(
        0.95, 0.5, "share of frames",
        "Choose clip.frames so that the person is in all of them, or bring masks.",
    ),
    "trusted_share": Scale(
        0.85, 0.5, "share of landmarks",
        "Many landmarks jump or are lost: bring keypoints of a better detector, or poses.",
    ),
    "person_height_px": Scale(
        100, 48, "px",
        "The person is small: crop the footage, come closer, or take a larger schedule.",
    ),
    "reprojection_share": Scale(
        0.02, 0.06, "share of the person's height",
        "The body does not lie on the landmarks: check focal length, calibration and keypoints.",
    ),
    "mask_body_iou": Scale(
        0.75, 0.5, "IoU",
        "Body and mask differ: look at check.png. Wide clothes do no harm; a mask of another "
        "person or with objects in it does, and so does a wrong focal length.",
    ),
    "background_light": Scale(
        2.0, 12.0, "of 255",
        "Frames show a background that nothing takes away, and the avatar would be made of it: set "
        "preprocess.background to auto.",
    ),
    "comparable_share": Scale(
        0.7, 0.35, "share of the person",
        "The background is unknown where the person ends, and colours there are not compared: film "
        "with a camera that stands still, or bring masks with exact edges.",
    ),
    "cut_off_share": Scale(
        0.05, 0.5, "share of frames",
        "The person leaves the picture: what is cut off is not modelled. Choose other frames.",
    ),
    "view_coverage_degrees": Scale(
        240, None, "degrees",
        "The camera never sees the rest of the body, which will be made up: let the person turn.",
    ),
    "blur_share": Scale(
        0.15, 0.45, "share of the person's height",
        "The fastest part is smeared over much of the person: check the exposure, or film with a "
        "shorter one.",
    ),
    # Neither says that an avatar is bad: never worse than warnings. White clothes are saturated in
    # two fifths of a person whose avatar is good; one joint that jumps says nothing of the others.
    "saturated_share": Scale(
        0.03, math.inf, "share of the person's pixels",
        "Blown highlights do not average as light does: film darker, or choose other frames.",
    ),
    "speed_ratio": Scale(
        3.0, math.inf, "times its neighbours",
        "The estimated pose jumps: look at the frames named in metrics/preprocess, bring poses.",
    ),
}  # fmt: skip

_OF_A_GUESSED_EXPOSURE = {  # of which a clip says nothing bad for sure
    "blur_share": _SCALES["blur_share"]._replace(
        fail=math.inf,
        advice="If the shutter was open as long as is guessed, the fastest part is smeared over "
        "much of the person: say clip.exposure_s where it is known.",
    ),
}


def check_scene(observations: Observations, fit: Mapping[str, Any]) -> dict[str, Any]:
    """Measure a scene as fitting will see it.

    Args:
        observations: the blurred ones.
        fit: what `preprocess` measured (`metrics/preprocess/<scene>.json`).

    Returns:
        The worst `verdict`, the `findings` by name, `blur_px` by part of the body, and from which
        directions (`azimuths`, degrees, 0 in front) the body was seen.
    """
    shown = observations.weights > 0
    joints = posed(observations.body, observations.poses).joints
    height = height_px(observations, joints[shown])
    blur = blur_extent(observations)
    azimuths = seen_azimuths(observations)
    values: dict[str, float | None] = {
        "training_frames": float(len(observations.train)),
        "person_share": float(shown.float().mean()),
        "trusted_share": float(observations.weights[shown].mean()),
        "person_height_px": height,
        "reprojection_share": reprojection_share(observations, fit, height),
        "mask_body_iou": mask_body_iou(observations),
        "background_light": background_light(observations),
        "comparable_share": comparable_share(observations),
        "cut_off_share": cut_off_share(observations, shown),
        "view_coverage_degrees": coverage(azimuths),
        "blur_share": max(blur.values()) / height if blur and height else None,
        "saturated_share": saturated_share(observations),
        "speed_ratio": (fit.get("track") or {}).get("speed_ratio"),
    }
    scales = _SCALES if observations.exposure_std is None else _SCALES | _OF_A_GUESSED_EXPOSURE
    findings = {name: judged(scales[name], value) for name, value in values.items()}
    return {
        "verdict": worst(finding.verdict for finding in findings.values()),
        "findings": {name: vars(finding) for name, finding in findings.items()},
        "blur_px": blur,
        "azimuths": [round(float(angle), 1) for angle in azimuths],
    }


def refuse_failed(scene: str, content: Mapping[str, Any], params: CheckParams) -> None:
    """Stop the pipeline at a scene that fails, if that is wanted.

    Raises:
        ArtifactError: naming what failed and where to look.
    """
    if params.on_failure == "stop" and content["verdict"] == "fail":
        failed = [name for name, f in content["findings"].items() if f["verdict"] == "fail"]
        raise ArtifactError(
            f"scene {scene} fails its check ({', '.join(failed)}); see check.png and index.html, "
            "or set check.on_failure to warn"
        )
