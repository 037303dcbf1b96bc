import dataclasses
import json

import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.findings import tell
from deblur_avatar.evaluation.scene_measures import (
    background_light,
    blur_extent,
    comparable_share,
    coverage,
    seen_azimuths,
    silhouette,
)
from deblur_avatar.pipeline.check import (
    CheckParams,
    check_scene,
    refuse_failed,
)
from deblur_avatar.reporting.check_pictures import check_page, draw_check
from tests.embedded_pictures import without_pictures

SIZE = 96


@pytest.fixture(scope="module")
def seen(make_observations):
    """Five frames of a person facing the camera, her left arm swinging; mattes as her body is."""
    filmed = make_observations(size=SIZE, degrees=8.0)
    masks = [silhouette(filmed, position) for position in range(5)]
    mattes = torch.from_numpy(np.stack(masks).astype(np.uint8) * 255)
    return dataclasses.replace(filmed, mattes=mattes)


def verdicts(observations, fit=None):
    findings = check_scene(observations, fit or {})["findings"]
    return {name: finding["verdict"] for name, finding in findings.items()}


def test_a_body_that_fills_its_mask_is_found_to(seen):
    content = check_scene(seen, {})
    assert content["findings"]["mask_body_iou"]["value"] == pytest.approx(1)
    assert content["findings"]["person_share"]["value"] == 1
    assert content["findings"]["cut_off_share"]["verdict"] == "ok"
    json.dumps(content)


def test_a_body_beside_its_mask_fails_and_says_what_to_do(seen):
    beside = dataclasses.replace(seen, mattes=seen.mattes.roll(20, dims=2))
    finding = check_scene(beside, {})["findings"]["mask_body_iou"]
    assert finding["verdict"] == "fail"
    assert "focal length" in finding["advice"]


def test_a_person_in_few_frames_is_warned_of(seen):
    assert (
        verdicts(dataclasses.replace(seen, weights=torch.tensor([1.0, 0, 1, 1, 1])))["person_share"]
        == "warn"
    )
    assert (
        verdicts(dataclasses.replace(seen, weights=torch.tensor([1.0, 0, 0, 0, 1])))["person_share"]
        == "fail"
    )


def test_blur_is_the_way_of_the_joints_while_the_shutter_is_open(seen):
    blur = blur_extent(seen)
    # The hand swings 8 degrees a frame, the shutter is open throughout.
    hand = blur["hands"]
    arm = 0.6 * 1.6 * SIZE / 4  # metres, in pixels at 4 m
    assert hand == pytest.approx(arm * np.radians(8), rel=0.4)
    assert blur["feet"] < 0.2 * hand
    half = dataclasses.replace(seen, exposure=seen.exposure / 2)
    assert blur_extent(half)["hands"] == pytest.approx(hand / 2, rel=1e-3)
    assert blur_extent(dataclasses.replace(seen, exposure=None)) == {}


def test_a_shutter_that_is_guessed_fails_no_clip(seen):
    long = dataclasses.replace(seen, exposure=100 * seen.exposure)
    guessed = dataclasses.replace(long, exposure_std=0.7)
    assert verdicts(long)["blur_share"] == "fail"
    assert verdicts(guessed)["blur_share"] == "warn"
    advice = check_scene(guessed, {})["findings"]["blur_share"]["advice"]
    assert "as long as is guessed" in advice
    assert "exposure_s" in advice


def test_directions_count_from_the_front_to_the_left(seen):
    np.testing.assert_allclose(seen_azimuths(seen), 0, atol=0.5)
    turned = dataclasses.replace(
        seen.poses, global_orient=torch.tensor([0.0, -np.pi / 2, 0]).float().repeat(5, 1)
    )
    # Turned to her right she shows the camera her left side.
    np.testing.assert_allclose(seen_azimuths(dataclasses.replace(seen, poses=turned)), 90, atol=0.5)


def test_coverage_is_what_all_frames_see_together():
    assert coverage(np.array([0.0])) == 120
    assert coverage(np.array([0.0, 5, -5])) == 130
    assert coverage(np.array([170.0, -170])) == 140
    assert coverage(np.arange(0.0, 360, 30)) == 360
    assert coverage(np.array([])) == 0


def test_saturated_pixels_and_people_cut_off_are_found(seen):
    bright = dataclasses.replace(seen, frames=torch.full_like(seen.frames, 255))
    assert verdicts(bright)["saturated_share"] == "warn"  # white clothes are no failure
    mattes = seen.mattes.clone()
    mattes[:, -1, 40:50] = 255
    assert verdicts(dataclasses.replace(seen, mattes=mattes))["cut_off_share"] == "fail"


def test_a_background_that_nothing_takes_away_is_found(seen):
    outside = seen.mattes[..., None] == 0
    black, grey = (torch.where(outside, level, seen.frames).to(torch.uint8) for level in (0, 90))
    assert verdicts(dataclasses.replace(seen, frames=black))["background_light"] == "ok"
    room = dataclasses.replace(seen, frames=grey)
    finding = check_scene(room, {})["findings"]["background_light"]
    assert finding["verdict"] == "fail"
    assert "preprocess.background" in finding["advice"]
    known = dataclasses.replace(room, backgrounds=torch.full_like(room.frames[:1], 90))
    assert verdicts(known)["background_light"] == "ok"
    # What is not compared does no harm.
    masked = dataclasses.replace(room, comparable=torch.where(seen.mattes == 0, 0, 255).byte())
    assert verdicts(masked)["background_light"] == "ok"


def test_background_light_is_the_mean_of_frames_with_a_person(seen):
    outside = seen.mattes[..., None] == 0
    levels = torch.arange(len(seen.frames))[:, None, None, None] * 10
    frames = torch.where(outside, levels, seen.frames).to(torch.uint8)
    weights = torch.ones(len(frames))
    weights[-1] = 0
    several = dataclasses.replace(seen, frames=frames, weights=weights)
    counts = outside.flatten(1).sum(1)[:-1].double()
    wanted = float((counts * levels.flatten()[:-1]).sum() / counts.sum())
    assert background_light(several) == pytest.approx(wanted)
    full = dataclasses.replace(several, mattes=torch.full_like(seen.mattes, 255))
    assert background_light(full) is None


def test_the_comparable_share_is_of_coverage(seen):
    halves = torch.zeros_like(seen.mattes)
    halves[::2], halves[1::2] = 255, 51
    cover = seen.mattes.double().flatten(1).sum(1)
    wanted = float((cover[::2].sum() + 0.2 * cover[1::2].sum()) / cover.sum())
    assert 0.2 < wanted < 1
    found = comparable_share(dataclasses.replace(seen, comparable=halves))
    assert found == pytest.approx(wanted)


def test_a_person_who_is_hardly_compared_is_found(seen):
    assert verdicts(seen)["comparable_share"] == "ok"
    none = dataclasses.replace(seen, comparable=torch.zeros_like(seen.mattes))
    assert verdicts(none)["comparable_share"] == "fail"


def test_what_preprocess_measured_is_judged_too(seen):
    height = check_scene(seen, {})["findings"]["person_height_px"]["value"]
    fit = {"fit": {"front": {"reprojection_px": 0.04 * height}}, "track": {"speed_ratio": 4.0}}
    found = check_scene(seen, fit)["findings"]
    assert found["reprojection_share"]["value"] == pytest.approx(0.04, rel=1e-3)
    assert found["reprojection_share"]["verdict"] == "warn"
    assert found["speed_ratio"]["verdict"] == "warn"
    assert verdicts(seen)["reprojection_share"] == "unknown"


def test_who_lies_is_as_tall_as_she_is_long(seen):
    pose = seen.poses.body_pose.clone()
    for side, angle in (("left", -1.3), ("right", 1.3)):  # arms down
        pose[:, SMPL_JOINT_NAMES.index(f"{side}_shoulder") - 1, 2] = angle
    seen = dataclasses.replace(seen, poses=dataclasses.replace(seen.poses, body_pose=pose))
    stands = check_scene(seen, {})["findings"]["person_height_px"]["value"]
    sideways = seen.cameras.viewmats.clone()
    quarter = torch.tensor([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    sideways[seen.train_camera] = quarter @ sideways[seen.train_camera]
    lying = dataclasses.replace(seen, cameras=dataclasses.replace(seen.cameras, viewmats=sideways))
    lies = check_scene(lying, {})["findings"]["person_height_px"]["value"]
    assert lies == pytest.approx(stands, rel=0.05)


def test_one_joint_that_jumps_once_condemns_no_clip(seen):
    """A dancer's foot was on the other foot's place for 2 frames of 150; her avatar was good."""
    found = check_scene(seen, {"track": {"speed_ratio": 10.8}})["findings"]
    assert found["speed_ratio"]["verdict"] == "warn"


def test_a_failed_scene_is_told_loudly_and_stops_only_if_asked(seen, caplog):
    content = check_scene(dataclasses.replace(seen, mattes=seen.mattes.roll(20, dims=2)), {})
    tell("hall", content)
    assert "FAIL hall: mask body iou" in caplog.text
    refuse_failed("hall", content, CheckParams(on_failure="warn"))
    with pytest.raises(ArtifactError, match=r"scene hall fails its check \(.*mask_body_iou"):
        refuse_failed("hall", content, CheckParams(on_failure="stop"))


def test_the_page_shows_every_finding_and_the_sheet(seen):
    content = check_scene(seen, {})
    sheet = draw_check(seen)
    page = check_page("hall", content, sheet)
    for name in content["findings"]:
        assert name.replace("_", " ") in page
    assert "not measured" in page
    assert "data:image/jpeg" in page
    assert "http" not in without_pictures(page)
    # Blue is dominant nowhere but on the body's outline and the camera's path.
    blue = (sheet[..., 2].astype(int) - sheet[..., 0] > 100).sum()
    assert blue > 300
