import dataclasses
import json

import pytest
import torch

from deblur_avatar.pipeline import self_check as checking
from deblur_avatar.pipeline.self_check import self_check
from deblur_avatar.reporting.self_check_pictures import draw_self_check, self_check_page
from tests.embedded_pictures import without_pictures
from tests.stages.running import run_script

CPU = torch.device("cpu")


def failed(observations, avatar, motion) -> set[str]:
    content = self_check(observations, avatar.to_artifact(1), motion, CPU).content
    return {name for name, found in content["findings"].items() if found["verdict"] == "fail"}


def test_a_good_avatar_passes(filmed, avatar, motion):
    content = self_check(filmed, avatar.to_artifact(1), motion, CPU).content
    assert content["verdict"] == "ok"
    json.dumps(content)


def test_surroundings_torn_into_the_avatar_fail(filmed, avatar, motion):
    # What a background that nothing took away does: Gaussians all around, which explain it.
    with torch.no_grad():
        scattered = avatar.gaussians.means[::2]
        scattered.add_(0.8 * torch.sin(50 * scattered))
    assert failed(filmed, avatar, motion) >= {
        "outside_filmed",
        "outside_turntable",
        "far_gaussians",
    }


@pytest.mark.parametrize(
    ("off", "verdict"), [(0.0, "ok"), (0.01, "ok"), (0.02, "warn"), (0.11, "fail")]
)
def test_a_haze_nearer_than_surroundings_is_told_apart_from_clothes(
    filmed, avatar, motion, off, verdict
):
    with torch.no_grad():
        avatar.gaussians.means[::2] += off * avatar.gaussians.means[::2].sin().sign()
    content = self_check(filmed, avatar.to_artifact(1), motion, CPU).content
    assert content["findings"]["fur_share"]["verdict"] == verdict


@pytest.mark.parametrize(("reach", "verdict"), [(0, "fail"), (2, "warn")])
def test_clothes_as_wide_in_masks_as_from_all_sides_only_warn(
    filmed, avatar, motion, reach, verdict
):
    with torch.no_grad():
        avatar.gaussians.means[::2] += 0.11 * avatar.gaussians.means[::2].sin().sign()
    wide = torch.nn.functional.max_pool2d(
        filmed.mattes[:, None].float(), 2 * reach + 1, stride=1, padding=reach
    )
    dressed = dataclasses.replace(filmed, mattes=wide[:, 0].to(torch.uint8))
    content = self_check(dressed, avatar.to_artifact(1), motion, CPU).content
    found = content["findings"]["fur_share"]
    assert found["verdict"] == verdict
    assert ("Masks show as much" in found["advice"]) == (verdict == "warn")


@pytest.mark.parametrize(
    ("fur", "clothes", "verdict"),
    [(0.25, 0.20, "warn"), (0.25, 0.18, "fail"), (0.10, 0.10, "warn"), (0.05, 0.0, "ok")],
)
def test_fur_beyond_wide_clothes_is_held_to_what_is_ok(
    filmed, avatar, motion, monkeypatch, fur, clothes, verdict
):
    asked = []

    def clothes_share(observations, looks, positions):
        asked.append((observations is filmed, len(looks), positions))
        return clothes

    monkeypatch.setattr(checking, "fur_share", lambda _: fur)
    monkeypatch.setattr(checking, "clothes_share", clothes_share)
    content = self_check(filmed, avatar.to_artifact(1), motion, CPU).content
    found = content["findings"]["fur_share"]
    assert found["verdict"] == verdict
    assert ("Masks show as much" in found["advice"]) == (fur > 0.15 and verdict == "warn")
    assert asked == [(True, len(filmed.train), list(filmed.train))] * (fur > 0.15)


@pytest.mark.parametrize(
    ("filmed_share", "own", "coverage", "verdict"),
    [
        (-0.1, 0.4, 0.9, "warn"),
        (-0.1, 0.7, 0.76, "warn"),
        (-0.1, 0.2, 0.9, "fail"),
        (-0.1, None, 0.9, "fail"),
        (-0.1, 0.7, 0.7, "fail"),
        (0.4, 0.9, 0.9, "warn"),
        (0.7, 0.1, 0.9, "ok"),
    ],
)
def test_edges_before_a_background_unlike_her_only_warn_where_her_colours_are_explained(
    filmed, avatar, motion, monkeypatch, filmed_share, own, coverage, verdict
):
    monkeypatch.setattr(checking, "explained_share", lambda *_: filmed_share)
    monkeypatch.setattr(checking, "own_explained_share", lambda *_: own)
    monkeypatch.setattr(checking, "coverage_iou", lambda *_: coverage)
    content = self_check(filmed, avatar.to_artifact(1), motion, CPU).content
    found = content["findings"]["explained_share"]
    assert (found["value"], found["verdict"]) == (filmed_share, verdict)
    softened = filmed_share < 0.3 and verdict == "warn"
    assert ("Of her own colours" in found["advice"]) == softened


def test_a_body_of_another_place_fails(filmed, avatar, motion):
    beside = dataclasses.replace(
        motion, centre=dataclasses.replace(motion.centre, transl=motion.centre.transl + 0.6),
        transl=motion.transl + 0.6,
    )  # fmt: skip
    assert failed(filmed, avatar, beside) >= {
        "coverage_iou",
        "explained_share",
        "worst_part_inside",
    }


def test_masks_of_somebody_else_fail(filmed, avatar, motion):
    other = dataclasses.replace(filmed, mattes=filmed.mattes.roll(24, dims=2))
    assert failed(other, avatar, motion) >= {"coverage_iou", "worst_part_inside"}


def test_colours_of_somebody_else_fail(filmed, avatar, motion):
    with torch.no_grad():
        avatar.gaussians.features.neg_()
    assert failed(filmed, avatar, motion) == {"explained_share"}


def test_an_avatar_that_shows_nothing_fails(filmed, avatar, motion):
    with torch.no_grad():
        avatar.gaussians.opacity_logits.fill_(-30)
    assert failed(filmed, avatar, motion) >= {"coverage_iou"}


def test_an_arm_that_moves_as_nobody_did_fails(filmed, avatar, motion, body):
    raised = motion.centre.body_pose.clone()
    raised[:, body.joint_names.index("left_shoulder") - 1, 2] += 1.6
    wrong = dataclasses.replace(motion, centre=dataclasses.replace(motion.centre, body_pose=raised))
    assert failed(filmed, avatar, wrong) == {"worst_part_inside"}


@pytest.mark.parametrize(("gone", "verdict"), [("left_elbow", "warn"), ("left_knee", "fail")])
def test_a_forearm_that_is_gone_warns_and_a_shin_fails(filmed, avatar, motion, body, gone, verdict):
    own = avatar.weights_at(avatar.gaussians.means).argmax(1)
    own = own == body.joint_names.index(gone)
    with torch.no_grad():
        avatar.gaussians.opacity_logits[own] = -30.0
    content = self_check(filmed, avatar.to_artifact(1), motion, CPU).content
    assert content["findings"]["worst_part_open"]["verdict"] == verdict
    assert max(content["open"], key=content["open"].get) == gone
    assert sorted(content["open"].values())[-2] < 0.1


def test_hands_that_are_lost_are_not_torn(filmed, avatar, motion, body):
    own = avatar.weights_at(avatar.gaussians.means).argmax(1)
    hands = [body.joint_names.index(f"{side}_{joint}") for side in ("left", "right")
             for joint in ("wrist", "hand")]  # fmt: skip
    with torch.no_grad():
        avatar.gaussians.opacity_logits[torch.isin(own, torch.tensor(hands))] = -30.0
    content = self_check(filmed, avatar.to_artifact(1), motion, CPU).content
    assert content["findings"]["worst_part_open"]["verdict"] == "ok"


def test_the_page_names_what_failed_and_loads_nothing(filmed, avatar, motion):
    with torch.no_grad():
        avatar.gaussians.features.neg_()
    checked = self_check(filmed, avatar.to_artifact(1), motion, CPU)
    sheet = draw_self_check(filmed, checked.filmed, checked.sides)
    page = self_check_page("anna-lean", checked.content, sheet)
    assert '<h1>anna-lean: <span class="fail">fail</span></h1>' in page
    assert "The avatar does not look like the frames set aside" in page
    assert "http" not in without_pictures(page.split("</style>")[1])


def test_what_lies_outside_is_red(filmed, avatar, motion):
    clean = self_check(filmed, avatar.to_artifact(1), motion, CPU)
    with torch.no_grad():
        avatar.gaussians.means[::4, 0] += 0.9
    torn = self_check(filmed, avatar.to_artifact(1), motion, CPU)

    def red(checked):
        sheet = draw_self_check(filmed, checked.filmed, checked.sides).astype(int)
        return int(((sheet[..., 0] > 200) & (sheet[..., 1] < 90) & (sheet[..., 2] < 90)).sum())

    assert red(torn) > 50 + 5 * red(clean)


def test_the_stage_writes_findings_a_picture_and_a_page(filmed, avatar, motion, tmp_path):
    filmed.save(tmp_path / "observations")
    avatar.to_artifact(1).save(tmp_path / "fusion/avatar")
    motion.save(tmp_path / "fusion/motion")
    done = run_script(
        "self_check", name="anna-lean", observations=tmp_path / "observations",
        fusion=tmp_path / "fusion", out=tmp_path / "out", metrics=tmp_path / "anna-lean.json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "anna-lean.json").read_text())["verdict"] == "ok"
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"self_check.png", "index.html"}
