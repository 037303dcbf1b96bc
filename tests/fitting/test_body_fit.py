import dataclasses

import pytest
import torch

from deblur_avatar.artifacts import Body, Poses
from deblur_avatar.avatar.body import posed_joints, posed_vertices
from deblur_avatar.errors import ArtifactError
from deblur_avatar.fitting import body_fit
from deblur_avatar.fitting.body_fit import BodyFit, fit_body
from deblur_avatar.fitting.landmarks import Landmarks
from tests.walking_person import FPS, detect_perfectly, ring_of_cameras, walking_poses

FRAMES = 10
CAMERAS = ring_of_cameras()
ALL = tuple(range(4))
LEFT_AND_RIGHT = [0, *[mark + (1 if mark % 2 else -1) for mark in range(1, 33)]]


@pytest.fixture(autouse=True)
def few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(body_fit, "COARSE_STEPS", 100)
    monkeypatch.setattr(body_fit, "FINE_STEPS", 60)
    monkeypatch.setattr(body_fit, "SURFACE_POINTS", 300)


@pytest.fixture(scope="module")
def truth(body: Body) -> Poses:
    return walking_poses(body, FRAMES)


@pytest.fixture(scope="module")
def people(body: Body, truth: Poses) -> list[Landmarks]:
    return [detect_perfectly(body, truth, CAMERAS, camera) for camera in ALL]


def fit(body: Body, people: list[Landmarks], recorded: tuple[int, ...] = ALL) -> BodyFit:
    return fit_body(body, CAMERAS, recorded, people, torch.arange(FRAMES) / FPS)


def motion(poses: Poses) -> tuple[torch.Tensor, ...]:
    return poses.betas, poses.global_orient, poses.body_pose, poses.transl


def joint_error(body: Body, found: Poses, truth: Poses) -> float:
    """Mean distance of joints, metres."""
    distance = posed_joints(body, *motion(found)) - posed_joints(body, *motion(truth))
    return float(distance.norm(dim=-1).mean())


def swapped(person: Landmarks) -> Landmarks:
    return dataclasses.replace(
        person,
        points=person.points[:, LEFT_AND_RIGHT],
        visibility=person.visibility[:, LEFT_AND_RIGHT],
    )


def without(person: Landmarks, frames: list[int]) -> Landmarks:
    found, points, mattes = person.found.clone(), person.points.clone(), person.mattes.clone()
    found[frames], points[frames], mattes[frames] = False, 0, 0
    return dataclasses.replace(person, found=found, points=points, mattes=mattes)


def test_a_seen_body_is_recovered(body: Body, truth: Poses, people: list[Landmarks]):
    found = fit(body, people)
    assert joint_error(body, found.poses, truth) < 0.015
    surface = posed_vertices(body, *motion(found.poses)) - posed_vertices(body, *motion(truth))
    assert surface.norm(dim=-1).mean() < 0.025
    assert found.residuals.median() < 0.01 * found.extent


def test_a_view_with_left_and_right_swapped_does_no_harm(
    body: Body, truth: Poses, people: list[Landmarks], caplog: pytest.LogCaptureFixture
):
    found = fit(body, [people[0], swapped(people[1]), *people[2:]])
    assert joint_error(body, found.poses, truth) < 0.02
    assert "camera cam1 agrees with the others on" in caplog.text


def test_frames_without_a_person_are_bridged(body: Body, truth: Poses, people: list[Landmarks]):
    gap = [4, 5]
    found = fit(body, [without(person, gap) for person in people])
    assert joint_error(body, found.poses, truth) < 0.03


def test_the_same_input_gives_the_same_poses(body: Body, people: list[Landmarks]):
    first, second = fit(body, people).poses, fit(body, people).poses
    assert all(torch.equal(a, b) for a, b in zip(motion(first), motion(second), strict=True))


def test_a_body_in_a_moved_world_is_the_same_body(
    body: Body, people: list[Landmarks], monkeypatch: pytest.MonkeyPatch
):
    turned = torch.eye(4)
    turned[:3, :3] = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # +Z up, as in a laboratory
    turned[:3, 3] = torch.tensor([0.5, -1.0, 2.0])
    viewmats = CAMERAS.viewmats @ torch.linalg.inv(turned)
    moved_cameras = dataclasses.replace(CAMERAS, viewmats=viewmats)
    here = fit(body, people).poses
    there = fit_body(body, moved_cameras, ALL, people, torch.arange(FRAMES) / FPS).poses
    expected = posed_joints(body, *motion(here)) @ turned[:3, :3].T + turned[:3, 3]
    assert (posed_joints(body, *motion(there)) - expected).norm(dim=-1).mean() < 0.005


def test_one_camera_is_refused(body: Body, people: list[Landmarks]):
    with pytest.raises(ArtifactError, match="two or more cameras"):
        fit(body, people[:1], (0,))


def test_footage_without_a_person_is_refused(body: Body, people: list[Landmarks]):
    nobody = [without(person, list(range(FRAMES))) for person in people]
    with pytest.raises(ArtifactError, match="no person found in any frame"):
        fit(body, nobody)


def test_cameras_that_never_agree_are_refused(body: Body, people: list[Landmarks]):
    elsewhere = dataclasses.replace(people[1], points=people[1].points + 500)
    with pytest.raises(ArtifactError, match="no two cameras agree"):
        fit(body, [people[0], elsewhere], (0, 1))
