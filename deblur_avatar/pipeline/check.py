"""Whether a scene is fit for training, found out before an hour is spent on it.

Each finding is one number with a verdict (`ok`, `warn`, `fail`, or `unknown` where it could not be
measured) and, unless all is well, a sentence of what to do. Pixels are those of the observations;
shares of the person's height are independent of how large the pictures are.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.artifacts import Observations
from deblur_avatar.avatar.body import posed_joints, posed_vertices
from deblur_avatar.config import CheckParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import camera_centres, project
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.imaging.mesh_rendering import View, cast_rays

logger = logging.getLogger(__name__)

SAMPLES = 24  # frames whose silhouettes are compared
HALF = 127  # of a matte's 255
SATURATED = 254  # sRGB code from which a channel holds no detail
SEEN_WITHIN = 60.0  # degrees between a surface's normal and the camera in which it is well seen
BIN = 5  # degrees
PARTS = {
    "torso": ("pelvis", "spine3", "neck"),
    "head": ("head",),
    "upper arms": ("left_elbow", "right_elbow"),
    "hands": ("left_hand", "right_hand"),
    "knees": ("left_knee", "right_knee"),
    "feet": ("left_foot", "right_foot"),
}


@dataclass(frozen=True)
class Finding:
    """One number, what it means and what to do about it."""

    value: float | None
    unit: str
    verdict: str
    advice: str


class _Scale(NamedTuple):
    """Up to which values a finding is ok, and from which it fails; a fall is worse if ok > fail."""

    ok: float
    fail: float | None  # None: never worse than a warning
    unit: str
    advice: str


_SCALES = {
    "training_frames": _Scale(30, 8, "frames", "Film longer, or lower clip.stride."),
    "person_share": _Scale(
        0.95, 0.5, "share of frames",
        "Choose clip.frames so that the person is in all of them, or bring masks.",
    ),
    "trusted_share": _Scale(
        0.85, 0.5, "share of landmarks",
        "Many landmarks jump or are lost: bring keypoints of a better detector, or poses.",
    ),
    "person_height_px": _Scale(
        100, 48, "px",
        "The person is small: crop the footage, come closer, or take a larger schedule.",
    ),
    "reprojection_share": _Scale(
        0.02, 0.06, "share of the person's height",
        "The body does not lie on the landmarks: check focal length, calibration and keypoints.",
    ),
    "mask_body_iou": _Scale(
        0.75, 0.5, "IoU",
        "Body and mask differ: look at check.png. Wide clothes do no harm; a mask of another "
        "person or with objects in it does, and so does a wrong focal length.",
    ),
    "cut_off_share": _Scale(
        0.05, 0.5, "share of frames",
        "The person leaves the picture: what is cut off is not modelled. Choose other frames.",
    ),
    "view_coverage_degrees": _Scale(
        240, None, "degrees",
        "The camera never sees the rest of the body, which will be made up: let the person turn.",
    ),
    "blur_share": _Scale(
        0.15, 0.45, "share of the person's height",
        "The fastest part is smeared over much of the person: check the exposure, or film with a "
        "shorter one.",
    ),
    "saturated_share": _Scale(
        0.03, 0.3, "share of the person's pixels",
        "Blown highlights do not average as light does: film darker, or choose other frames.",
    ),
    "speed_ratio": _Scale(
        3.0, 8.0, "times its neighbours",
        "The estimated pose jumps: look at the frames named in metrics/preprocess, bring poses.",
    ),
}  # fmt: skip


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
    poses = observations.poses
    motion = poses.global_orient, poses.body_pose, poses.transl
    joints = posed_joints(observations.body, poses.betas, *motion)
    height = _height_px(observations, joints[shown])
    blur = blur_extent(observations)
    azimuths = seen_azimuths(observations)
    values: dict[str, float | None] = {
        "training_frames": float(len(observations.train)),
        "person_share": float(shown.float().mean()),
        "trusted_share": float(observations.weights[shown].mean()),
        "person_height_px": height,
        "reprojection_share": _reprojection(observations, fit, height),
        "mask_body_iou": _overlap(observations),
        "cut_off_share": _cut_off(observations, shown),
        "view_coverage_degrees": coverage(azimuths),
        "blur_share": max(blur.values()) / height if blur and height else None,
        "saturated_share": _saturated(observations),
        "speed_ratio": (fit.get("track") or {}).get("speed_ratio"),
    }
    findings = {name: judged(name, value) for name, value in values.items()}
    return {
        "verdict": worst([finding.verdict for finding in findings.values()]),
        "findings": {name: vars(finding) for name, finding in findings.items()},
        "blur_px": blur,
        "azimuths": [round(float(angle), 1) for angle in azimuths],
    }


def judged(name: str, value: float | None) -> Finding:
    """Give a number its verdict and advice."""
    scale = _SCALES[name]
    if value is None:
        return Finding(None, scale.unit, "unknown", "")
    rising = scale.fail is not None and scale.fail > scale.ok
    falls = not rising
    good = value >= scale.ok if falls else value <= scale.ok
    if good:
        return Finding(value, scale.unit, "ok", "")
    bad = scale.fail is not None and (value < scale.fail if falls else value > scale.fail)
    return Finding(value, scale.unit, "fail" if bad else "warn", scale.advice)


def worst(verdicts: list[str]) -> str:
    """`fail` before `warn` before `ok`."""
    return next((verdict for verdict in ("fail", "warn") if verdict in verdicts), "ok")


def tell(scene: str, content: Mapping[str, Any]) -> None:
    """Log the findings, loudly where they are bad."""
    for name, finding in content["findings"].items():
        if finding["verdict"] in ("warn", "fail"):
            logger.warning(
                "%s %s: %s %.3g %s. %s", finding["verdict"].upper(), scene, name.replace("_", " "),
                finding["value"], finding["unit"], finding["advice"],
            )  # fmt: skip
    logger.info("check %s: %s", scene, content["verdict"])


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


def blur_extent(observations: Observations) -> dict[str, float]:
    """How far each part of the body travels in the picture while the shutter is open, pixels.

    The 95th percentile over the frames with a person, of the fastest joint of the part; speeds are
    central differences of the estimated poses. Empty where the exposure is not known.
    """
    if not observations.exposure or len(observations.timestamps) < 3:
        return {}
    poses, camera = observations.poses, observations.train_camera
    motion = poses.global_orient, poses.body_pose, poses.transl
    joints = posed_joints(observations.body, poses.betas, *motion)
    lens = observations.cameras.Ks[camera], observations.cameras.viewmats[camera]
    pixels, _ = project(joints, *lens)
    times = observations.timestamps
    speeds = (pixels[2:] - pixels[:-2]).norm(dim=-1) / (times[2:] - times[:-2])[:, None]
    travel = speeds[observations.weights[1:-1] > 0] * observations.exposure
    names = observations.body.joint_names
    if not len(travel):
        return {}
    return {
        part: float(
            torch.quantile(travel[:, [names.index(joint) for joint in joints_]].amax(1), 0.95)
        )
        for part, joints_ in PARTS.items()
        if all(joint in names for joint in joints_)
    }


def seen_azimuths(observations: Observations) -> Float[np.ndarray, " F"]:
    """Where the camera stood about the body in training frames: degrees, 0 front, 90 left."""
    frames = [index for index in observations.train if observations.weights[index] > 0]
    poses = observations.poses.at(frames)
    centre = camera_centres(observations.cameras.viewmats[observations.train_camera])
    motion = poses.global_orient, poses.body_pose, poses.transl
    pelvis = posed_joints(observations.body, poses.betas, *motion)[:, 0]
    towards = (centre - pelvis)[:, None] @ axis_angle_to_matrix(poses.global_orient)
    return np.degrees(np.arctan2(towards[:, 0, 0].numpy(), towards[:, 0, 2].numpy()))


def coverage(azimuths: Float[np.ndarray, " F"]) -> float:
    """Degrees about the body's vertical whose surface some frame sees within `SEEN_WITHIN`."""
    bins = np.arange(-180, 180, BIN) + BIN / 2
    apart = np.abs((bins[:, None] - azimuths[None] + 180) % 360 - 180)
    return float(BIN * (apart.min(1) <= SEEN_WITHIN).sum()) if len(azimuths) else 0.0


def silhouette(observations: Observations, position: int) -> Bool[np.ndarray, "H W"]:
    """The estimated body in one frame."""
    view = View.of(observations.cameras, observations.train_camera, samples_per_axis=1)
    pose = observations.poses.at([position])
    vertices = posed_vertices(
        observations.body, pose.betas, pose.global_orient, pose.body_pose, pose.transl
    )[0]
    rays = view.directions.reshape(-1, 3)
    hits = cast_rays(vertices.numpy(), observations.body.faces.numpy(), view.centre, rays)
    return (hits.triangle >= 0).reshape(view.height, view.width)


def spread(observations: Observations, count: int) -> list[int]:
    """Frames with a person, evenly over the clip."""
    shown = torch.nonzero(observations.weights > 0).flatten().tolist()
    steps = np.linspace(0, len(shown) - 1, min(count, len(shown))).round().astype(int)
    return [shown[step] for step in steps]


def _height_px(observations: Observations, joints: Float[Tensor, "F J 3"]) -> float | None:
    camera = observations.train_camera
    lens = observations.cameras.Ks[camera], observations.cameras.viewmats[camera]
    rows = project(joints, *lens)[0][..., 1]
    # From the head's joint to the toes' are some nine tenths of a person.
    return float((rows.amax(1) - rows.amin(1)).median() / 0.9) if len(rows) else None


def _reprojection(
    observations: Observations, fit: Mapping[str, Any], height: float | None
) -> float | None:
    name = observations.cameras.names[observations.train_camera]
    found = ((fit.get("fit") or {}).get(name) or {}).get("reprojection_px")
    if found is None or not height:
        return None
    crop, size = (
        values[observations.train_camera]
        for values in (observations.crops, observations.cameras.sizes)
    )
    return float(found * size[1] / crop[3] / height)


def _overlap(observations: Observations) -> float | None:
    scores = []
    for position in spread(observations, SAMPLES):
        body, mask = (
            silhouette(observations, position),
            observations.mattes[position].numpy() > HALF,
        )
        if (body | mask).any():
            scores.append((body & mask).sum() / (body | mask).sum())
    return float(np.mean(scores)) if scores else None


def _cut_off(observations: Observations, shown: Bool[Tensor, " F"]) -> float:
    """Share of frames whose mask reaches the picture's rim."""
    full = observations.mattes[shown] > HALF
    rim = full[:, 0].any(1) | full[:, -1].any(1) | full[:, :, 0].any(1) | full[:, :, -1].any(1)
    return float(rim.float().mean())


def _saturated(observations: Observations) -> float | None:
    inside = observations.mattes > 2 * HALF - 4
    pixels = observations.frames[inside]
    return float((pixels >= SATURATED).any(-1).float().mean()) if len(pixels) else None
