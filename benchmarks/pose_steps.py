"""Steps of estimating poses: what a true one in place of an estimated one brings.

    python -m benchmarks.pose_steps [--scene street] [--json FILE]

detects the person in the film of a scene of `source: street` and fits the body several times, each
time with other parts of what the fit is given replaced by the truth: focal length, mattes,
landmarks in the picture, the detector's guess of their depth; and once with nothing true and
MediaPipe's smaller pose model. Prints JSON: the errors of joints
of each fit, as in `metrics/<scene>/<method>.json` (`steps.poses`), so that it can be seen which
step loses how much. Needs `dvc repro preprocess@<scene>`; 3 minutes, no avatar.
"""

import argparse
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from benchmarks.record import print_record
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.bodies.posed_body import joint_transforms, posed, shaped_joints
from deblur_avatar.body_estimation.body_fit import fit_body
from deblur_avatar.body_estimation.body_landmarks import landmark_map
from deblur_avatar.body_estimation.landmarks import Landmarks, detect_with_mediapipe
from deblur_avatar.body_estimation.monocular_prior import HIPS
from deblur_avatar.body_estimation.person_choice import detect_main_person
from deblur_avatar.body_estimation.pose_model import PoseModel
from deblur_avatar.body_estimation.trimming import trimmed
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.comparisons import true_poses
from deblur_avatar.evaluation.estimated_steps import joint_errors
from deblur_avatar.geometry.cameras import project
from deblur_avatar.imaging.backgrounds import BackgroundEstimator

SMALLER = "as estimated, smaller pose model"
FITS = {
    "as estimated": (),
    "true focal length": ("focal",),
    "true mattes": ("mattes",),
    "true landmarks in the picture": ("points",),
    "true guess in space": ("world",),
    "true landmarks and guess": ("points", "world"),
    "all true": ("focal", "mattes", "points", "world"),
}


@dataclass(frozen=True)
class Truth:
    """What the fit would be given by a detector that is never wrong."""

    poses: Poses
    focal: float  # pixels
    mattes: UInt8[Tensor, "F H W"]

    @classmethod
    def of(cls, observations: Observations, reference: Reference) -> "Truth":
        """At the middle of each exposure.

        Raises:
            ArtifactError: if the film does not know it.
        """
        poses = true_poses(observations, reference)
        if reference.filmed is None or poses is None:
            raise ArtifactError("this scene knows no true poses; one of source: street does")
        return cls(poses, reference.filmed.focal, reference.filmed.mattes)


def detected(clip: BlurryClip, model: PoseModel) -> Landmarks:
    """The person as `preprocess` finds her, mattes trimmed where the background is known."""
    frames = clip.frames[0]
    person, _ = detect_main_person(frames, partial(detect_with_mediapipe, model=model))
    background = BackgroundEstimator(frames).background("auto", person.mattes)
    return trimmed(frames, person, background, by_limbs=False)


def with_truth(
    clip: BlurryClip, body: Body, person: Landmarks, truth: Truth, parts: tuple[str, ...]
) -> tuple[BlurryClip, Landmarks]:
    """A clip and a person some parts of whom are true; true landmarks are surely seen."""
    marks = landmark_map()
    rows, hips = list(marks.rows), [marks.rows.index(hip) for hip in HIPS]
    poses = truth.poses
    transforms = joint_transforms(
        body, poses.betas, poses.global_orient, poses.body_pose, poses.transl
    )
    places = marks.positions(transforms, shaped_joints(body, poses.betas), marks.offsets)
    viewmat, Ks = clip.cameras.viewmats[clip.train_camera], clip.cameras.Ks.clone()
    K = Ks[clip.train_camera]
    K[0, 0] = K[1, 1] = truth.focal
    if "points" in parts:
        points = person.points.clone()
        points[:, rows] = project(places, K, viewmat)[0]
        person = replace(person, points=points, visibility=torch.ones_like(person.visibility))
    if "world" in parts and person.world is not None:
        world = person.world.clone()
        seen = places @ viewmat[:3, :3].T
        world[:, rows] = seen - seen[:, hips].mean(1, keepdim=True)
        person = replace(person, world=world)
    if "mattes" in parts:
        person = replace(person, mattes=truth.mattes)
    if "focal" in parts:
        clip = replace(clip, cameras=replace(clip.cameras, Ks=Ks))
    return clip, person


def errors(
    clip: BlurryClip, body: Body, person: Landmarks, true: Float[Tensor, "F J 3"]
) -> dict[str, float]:
    """Of the joints of a body that is fitted to a person."""
    fitted = fit_body(body, clip.cameras, clip.recorded, [person], clip.timestamps)
    found = posed(body, fitted.poses).joints
    return {name: round(value, 4) for name, value in joint_errors(found, true).items()}


def main() -> None:
    """Detect once, fit with each set of true parts, print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scene", default="street")
    parser.add_argument("--body", default="anny")
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    body = Body.load(options.data / "body" / options.body)
    clip = BlurryClip.load(options.data / "blur" / options.scene)
    observations = Observations.load(options.data / "preprocess" / options.scene / "blurred")
    reference = Reference.load(options.data / "clip" / options.scene / "reference")
    truth = Truth.of(observations, reference)
    true, person = posed(body, truth.poses).joints, detected(clip, "heavy")
    wrong = partial(errors, body=body, true=true)
    rows: dict[str, Any] = {SMALLER: wrong(clip, person=detected(clip, "full"))}
    for name, parts in FITS.items():
        given, seen = with_truth(clip, body, person, truth, parts)
        rows[name] = wrong(given, person=seen)
    print_record({"scene": options.scene, "frames": len(clip.timestamps), **rows}, options.json)


if __name__ == "__main__":
    main()
