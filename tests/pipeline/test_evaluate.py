import dataclasses
import json
import math

import pytest
import torch

from deblur_avatar.artifacts.reference import FilmedTruth
from deblur_avatar.pipeline.evaluate import evaluate
from deblur_avatar.reporting.evaluation_pictures import colour_map, draw_pictures

pytestmark = pytest.mark.portable

CPU = torch.device("cpu")
IMAGE_KEYS = {
    "psnr", "ssim", "ssim_range2", "ms_ssim", "flip", "lpips_vgg", "psnr_foreground", "psnr_seen",
    "ssim_seen", "flip_seen", "sharpness_ratio", "sharpness_ratio_seen",
}  # fmt: skip


def measured(scene, **changes):
    parts = {field.name: getattr(scene, field.name) for field in dataclasses.fields(scene)}
    parts |= changes
    return evaluate(
        parts["observations"], parts["reference"], parts["avatar"], parts["motion"], CPU
    ).metrics


def test_the_file_has_the_keys_that_reports_read(scene):
    content = measured(scene)
    assert set(content["image"]) == IMAGE_KEYS
    assert set(content["motion"]) == {
        "joint_error_mm", "surface_error_mm", "joint_error_deg", "travel_error_mm",
        "direction_accuracy",
    }  # fmt: skip
    assert set(content["model"]) == {
        "gaussians", "parameters", "megabytes", "virtual_poses_mean", "parts",
    }  # fmt: skip
    assert content["recovery"] == dict.fromkeys(("psnr", "psnr_seen", "ssim", "flip", "lpips_vgg"))
    assert content["gap_to_ceiling_db"] is None
    assert content["counts"] == {"novel_views": 8, "novel_poses": 6}
    json.dumps(content)


def test_an_avatar_that_is_the_truth_scores_near_the_best(scene):
    content = measured(scene)
    # Twice as many pixels, averaged, are not quite what is drawn at half the size.
    assert content["image"]["psnr"] > 28
    assert content["image"]["flip"] < 0.12
    assert 0.7 < content["image"]["sharpness_ratio"] < 1.4
    assert content["novel_pose"]["psnr"] > 28
    assert content["motion"]["joint_error_mm"] == pytest.approx(0, abs=0.1)
    assert content["initial"]["joint_error_mm"] == pytest.approx(0, abs=0.1)
    assert content["image"]["lpips_vgg"] is None
    assert content["image"]["ms_ssim"] is None  # pictures of 24 pixels


def test_poses_refined_on_the_training_camera_are_those_of_novel_views(scene):
    centre = scene.motion.centre
    shifted = dataclasses.replace(centre, transl=centre.transl + torch.tensor([0.0, 0.1, 0]))
    content = measured(scene, motion=dataclasses.replace(scene.motion, centre=shifted))
    before = measured(scene)
    assert content["image"]["psnr"] < before["image"]["psnr"] - 3
    assert content["novel_pose"]["psnr"] == before["novel_pose"]["psnr"]
    assert content["motion"]["joint_error_mm"] == pytest.approx(100, abs=0.1)
    assert content["initial"]["joint_error_mm"] == pytest.approx(0, abs=0.1)


def test_novel_poses_are_true_where_the_truth_is_known_and_estimated_elsewhere(scene):
    poses = scene.observations.poses
    wrong = dataclasses.replace(poses, transl=poses.transl + torch.tensor([0.0, 0.1, 0]))
    observations = dataclasses.replace(scene.observations, poses=wrong)
    told = measured(scene, observations=observations)
    assert told["novel_pose"]["psnr"] == measured(scene)["novel_pose"]["psnr"]
    untold = measured(
        scene,
        observations=observations,
        reference=dataclasses.replace(scene.reference, motion=None, motion_times=None),
    )
    assert untold["novel_pose"]["psnr"] < told["novel_pose"]["psnr"] - 3
    assert set(untold["motion"].values()) == {None}
    assert set(untold["initial"].values()) == {None}


def test_test_cameras_are_told_apart(scene):
    spoilt = scene.reference.images.clone()
    spoilt[scene.reference.camera_indices == 2] = 255
    content = measured(scene, reference=dataclasses.replace(scene.reference, images=spoilt))
    before = measured(scene)
    assert set(content["cameras"]) == {"left", "right"}
    assert content["cameras"]["left"] == before["cameras"]["left"]
    assert content["cameras"]["right"]["psnr"] < 10
    mean = (content["cameras"]["left"]["psnr"] + content["cameras"]["right"]["psnr"]) / 2
    assert content["image"]["psnr"] == pytest.approx(mean)


def test_a_still_motion_misses_the_travel(scene):
    motion = measured(scene)["motion"]
    assert motion["travel_error_mm"] > 5
    assert motion["direction_accuracy"] is None
    instant = dataclasses.replace(scene.observations, exposure=None)
    assert measured(scene, observations=instant)["motion"]["travel_error_mm"] is None


def test_size_counts_every_number_of_the_avatar(scene):
    size = measured(scene)["model"]
    assert size["gaussians"] == 150
    assert size["parameters"] == 150 * (3 + 4 + 3 + 1 + 3)
    assert size["megabytes"] == pytest.approx(4e-6 * size["parameters"])
    assert size["parts"] == ["motion:frame"]
    assert size["virtual_poses_mean"] == 1


def test_rendering_speed_is_measured(scene):
    evaluation = evaluate(scene.observations, scene.reference, scene.avatar, scene.motion, CPU)
    assert math.isfinite(evaluation.render_fps)
    assert evaluation.render_fps > 1


def test_pictures_show_views_of_every_camera_once(scene, tmp_path):
    evaluation = evaluate(scene.observations, scene.reference, scene.avatar, scene.motion, CPU)
    pictures = draw_pictures(
        evaluation.comparisons, scene.observations, scene.avatar, scene.motion, CPU
    )
    shown = [(entry["camera"], entry["frame"]) for entry in pictures.index]
    assert len(shown) == len(set(shown)) == 8
    assert {camera for camera, _ in shown} == {"left", "right"}
    assert sum(entry["novel_pose"] for entry in pictures.index) == 2
    for entry in pictures.index:
        blurred = pictures.files[entry["blurred"]]
        position = scene.observations.frame_indices.index(entry["frame"])
        assert (blurred == scene.observations.frames[position].numpy()).all()
    pictures.save(tmp_path)
    assert (tmp_path / "strip.png").exists()
    sheet = pictures.files["turntable.png"]
    assert sheet.shape[0] < sheet.shape[1]
    assert (sheet > 200).any()


def test_a_difference_is_drawn_darker_the_smaller_it_is():
    ramp = torch.linspace(0, 1, 256).reshape(1, -1).numpy()
    brightness = colour_map(ramp).astype(int).sum(-1)[0]
    assert brightness[0] < 10
    assert brightness[-1] > 550
    assert brightness[128] > brightness[40] > brightness[0]


def without_truth(scene):
    reference = scene.reference
    nothing = {
        name: getattr(reference, name)[:0]
        for name in ("images", "mattes", "camera_indices", "frame_indices", "novel_pose")
    }
    return dataclasses.replace(reference, **nothing, motion=None, motion_times=None)


def test_footage_without_truth_is_measured_by_the_blurred_frames_it_explains(scene):
    content = measured(scene, reference=without_truth(scene))
    assert content["image"] is None
    assert content["novel_pose"] is None
    assert content["reblur"] == measured(scene)["reblur"]
    assert content["reblur"]["psnr"] > 28
    assert content["counts"] == {"novel_views": 0, "novel_poses": 0}
    json.dumps(content)


def test_without_truth_pictures_show_what_was_set_aside(scene, tmp_path):
    reference = without_truth(scene)
    evaluation = evaluate(scene.observations, reference, scene.avatar, scene.motion, CPU)
    pictures = draw_pictures(
        evaluation.comparisons, scene.observations, scene.avatar, scene.motion, CPU
    )
    (entry,) = pictures.index  # frame 2 validates
    assert entry["frame"] == scene.observations.frame_indices[2]
    assert "truth" not in entry
    assert (pictures.files[entry["blurred"]] == scene.observations.frames[2].numpy()).all()
    difference = pictures.files[entry["averaged"]].astype(int) - pictures.files[entry["blurred"]]
    assert abs(difference).mean() < 3
    assert {"strip.png", "turntable.png"} < set(pictures.files)


def test_footage_that_knows_the_truth_of_its_steps_has_their_errors(scene):
    """An avatar right in itself, in poses that were estimated wrong."""
    frames = scene.observations.frame_indices[-1] + 1
    mattes = torch.zeros(frames, 48, 48, dtype=torch.uint8)
    mattes[list(scene.observations.frame_indices)] = (
        scene.observations.mattes.repeat_interleave(2, 1).repeat_interleave(2, 2)
    )  # fmt: skip
    reference = dataclasses.replace(
        scene.reference,
        viewmats=scene.observations.cameras.viewmats[scene.reference.camera_indices],
        filmed=FilmedTruth(mattes=mattes, focal=76.8),
    )
    centre = scene.motion.centre
    wrong = centre.body_pose.clone()
    wrong[:, 15, 2] += 1.0  # the left arm
    motion = dataclasses.replace(scene.motion, centre=dataclasses.replace(centre, body_pose=wrong))
    content = measured(scene, reference=reference, motion=motion)
    assert content["steps"]["mattes"]["iou"] == pytest.approx(1)
    assert content["steps"]["poses"]["fitted"]["rooted_mm"] > 10
    assert content["steps"]["poses"]["initial"]["rooted_mm"] < 1
    assert content["in_true_poses"]["psnr"] > content["image"]["psnr"] + 1
    assert "steps" not in measured(scene)
    json.dumps(content)
