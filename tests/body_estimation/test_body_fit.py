import dataclasses
import math

import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import joint_transforms, posed_joints, posed_vertices
from deblur_avatar.body_estimation import body_fit, monocular_prior
from deblur_avatar.body_estimation.body_fit import BodyFit, fit_body
from deblur_avatar.body_estimation.body_landmarks import landmark_map
from deblur_avatar.body_estimation.landmarks import COUNT, Landmarks
from deblur_avatar.body_estimation.part_fit import PART_MAP, SPREAD
from deblur_avatar.body_estimation.track_smoothness import measure_track
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.estimated_steps import joint_errors
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from tests.process_state import by_threads
from tests.walking_person import (
    FPS,
    detect_perfectly,
    parts_perfectly,
    ring_of_cameras,
    walking_poses,
)

pytestmark = pytest.mark.portable

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


def fit(
    body: Body,
    people: list[Landmarks],
    recorded: tuple[int, ...] = ALL,
    *,
    any_pose: bool = False,
) -> BodyFit:
    times = torch.arange(FRAMES) / FPS
    return fit_body(body, CAMERAS, recorded, people, times, any_pose=any_pose)


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


def cost_of_offsets(body: Body, person: Landmarks, frames: int, part_away: float = 0.0) -> float:
    """What it costs that landmarks lie 10 cm from where they are expected, in a clip so long."""
    times = torch.arange(frames) / FPS
    problem, transl = body_fit._problem(body, CAMERAS, (0,), [person], times, False)
    still = torch.zeros(len(transl), 3)

    def cost(away: float) -> float:
        unknowns = body_fit._Unknowns(
            torch.zeros(body.shape_dirs.shape[2]), still, still.repeat(1, len(body.parents) - 1),
            transl, problem.marks.offsets + away, PART_MAP.offsets + part_away * away,
        )  # fmt: skip
        return float(body_fit._priors(problem, unknowns, body_fit._pose(problem, unknowns)))

    return cost(0.1) - cost(0.0)


def test_long_clips_move_landmarks_no_farther_than_short_ones(body: Body, people: list[Landmarks]):
    """Else they run away: by 20 cm in clips of 300 frames, and hands lie beside where they are."""
    person = people[0]
    half = Landmarks(person.found[:5], person.points[:5], person.visibility[:5], person.mattes[:5])
    short, whole = (cost_of_offsets(body, *clip) for clip in ((half, 5), (person, FRAMES)))
    assert whole == pytest.approx(2 * short, rel=1e-3)
    points = 3 * PART_MAP.offsets.shape[0] * FRAMES * (body_fit.OFFSET_TRUST * 0.1) ** 2
    with_parts = cost_of_offsets(body, person, FRAMES, part_away=1.0)
    assert with_parts - whole == pytest.approx(points / SPREAD**2, rel=1e-3)


def test_the_number_of_threads_changes_no_bit(body: Body, people: list[Landmarks]):
    results = by_threads(lambda: motion(fit(body, people).poses), 1, 2)
    for one, two in zip(*results, strict=True):
        assert torch.equal(one, two)


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
    times = torch.arange(FRAMES) / FPS
    there = fit_body(body, moved_cameras, ALL, people, times).poses
    expected = posed_joints(body, *motion(here)) @ turned[:3, :3].T + turned[:3, 3]
    assert (posed_joints(body, *motion(there)) - expected).norm(dim=-1).mean() < 0.005


def test_one_view_and_a_guess_of_depth_recover_the_body(
    body: Body, truth: Poses, people: list[Landmarks]
):
    guessed = people[0].world * 1.1  # type: ignore[operator]  # a detector's idea of her height
    found = fit(body, [dataclasses.replace(people[0], world=guessed)], (0,))
    # Distance from the camera is known as well as the height is: her own is 4 % off the mean.
    away, true = (posed_joints(body, *motion(poses)) for poses in (found.poses, truth))
    about = (away - away[:, :1]) - (true - true[:, :1])
    assert about.norm(dim=-1).mean() < 0.05
    assert (away - true).norm(dim=-1).mean() < 0.25
    assert found.residuals.median() < 0.015 * found.extent
    assert found.trust.min() == 1


def test_in_one_view_jumps_and_losses_are_bridged_and_trusted_less(
    body: Body, truth: Poses, people: list[Landmarks]
):
    points, visibility = people[0].points.clone(), people[0].visibility.clone()
    points[5, [13, 15, 19]] += torch.tensor([60.0, -40])  # the left arm jumps away and back
    visibility[6, 15:23] = 0.05  # the hands are lost
    blurred = dataclasses.replace(people[0], points=points, visibility=visibility)
    found = fit(body, [blurred], (0,))
    assert found.flags["jumped"] >= 3
    assert found.trust.argsort()[:2].sort().values.tolist() == [5, 6]
    clean = posed_joints(body, *motion(fit(body, people[:1], (0,)).poses))
    joints = posed_joints(body, *motion(found.poses))
    assert (joints - clean).norm(dim=-1).max() < 0.08
    steps = measure_track(body, found.poses, torch.arange(FRAMES) / FPS, found.trust > 0)
    assert steps["speed_ratio"] < 3


def test_landmarks_that_a_format_does_not_have_are_not_lost(body: Body, people: list[Landmarks]):
    """COCO's have no heels, toes and knuckles: perfect ones were trusted by 0.71 at most."""
    there, visibility = [0, *range(11, 17), *range(23, 29)], torch.zeros(FRAMES, COUNT)
    visibility[:, there] = 1.0
    coco = dataclasses.replace(people[0], visibility=visibility)
    assert fit(body, [coco], (0,)).trust.tolist() == [1.0] * FRAMES
    visibility[4, 15] = 0.1
    found = fit(body, [dataclasses.replace(coco, visibility=visibility)], (0,)).trust
    assert found[4] == pytest.approx(1 - 1 / len(set(there) & set(landmark_map().rows)))


@pytest.mark.parametrize("views", [(0,), ALL], ids=["one view", "four"])
def test_poses_beside_a_gap_in_time_are_as_good_as_elsewhere(body: Body, views: tuple[int, ...]):
    """A second is missing, in which she went on for a metre and turned by a radian."""
    there = [*range(8), *range(68, 76)]
    walked = walking_poses(body, 76).at(there)
    middle = walked.transl.mean(0) * torch.tensor([1.0, 0, 0])
    truth = dataclasses.replace(
        walked,
        global_orient=walked.global_orient * torch.tensor([0.0, 0.5, 0.0]),
        transl=walked.transl - middle,
    )
    seen = [detect_perfectly(body, truth, CAMERAS, camera) for camera in views]
    found = fit_body(body, CAMERAS, views, seen, torch.tensor(there) / FPS)
    errors = found.residuals.mean((0, 2)) / found.extent
    assert errors[7:9].mean() < 1.5 * errors[[*range(5), *range(11, 16)]].mean() + 1e-3


def test_one_view_without_a_guess_of_depth_still_faces_the_right_way(
    body: Body, truth: Poses, people: list[Landmarks]
):
    found = fit(body, [dataclasses.replace(people[0], world=None)], (0,))
    front = axis_angle_to_matrix(found.poses.global_orient)[..., 2]
    assert (front * axis_angle_to_matrix(truth.global_orient)[..., 2]).sum(-1).min() > 0.5


def test_footage_without_a_person_is_refused(body: Body, people: list[Landmarks]):
    nobody = [without(person, list(range(FRAMES))) for person in people]
    with pytest.raises(ArtifactError, match="no person found in any frame"):
        fit(body, nobody)


def test_cameras_that_never_agree_are_refused(body: Body, people: list[Landmarks]):
    elsewhere = dataclasses.replace(people[1], points=people[1].points + 500)
    with pytest.raises(ArtifactError, match="no two cameras agree"):
        fit(body, [people[0], elsewhere], (0, 1))


def gesturing(poses: Poses) -> Poses:
    """The same walk, forearms and wrists twisted, fingers bent and the head turned aside."""
    pose = poses.body_pose.clone()
    turns = {"left_elbow": (0, 35), "left_wrist": (0, 40), "right_wrist": (0, -60)}
    turns |= {"left_hand": (2, -50), "right_hand": (2, 70), "head": (1, 35)}
    for name, (axis, degrees) in turns.items():
        pose[:, SMPL_JOINT_NAMES.index(name) - 1, axis] = math.radians(degrees)
    return dataclasses.replace(poses, body_pose=pose)


def turned_off(body: Body, found: Poses, truth: Poses, names: tuple[str, ...]) -> list[float]:
    """Mean angles between two poses' joints in the world, degrees."""
    rows = [SMPL_JOINT_NAMES.index(name) for name in names]
    ours, true = (joint_transforms(body, *motion(p))[:, rows, :3, :3] for p in (found, truth))
    apart = matrix_to_axis_angle(ours.transpose(-1, -2) @ true).norm(dim=-1)
    return torch.rad2deg(apart).mean(0).tolist()


@pytest.mark.parametrize("recorded", [(0,), (0, 1)])
def test_hands_and_head_look_where_their_landmarks_say(body: Body, truth: Poses, recorded):
    """Landmarks of the whole body alone leave them tens of degrees off."""
    poses = gesturing(truth)
    plain = [detect_perfectly(body, poses, CAMERAS, camera) for camera in recorded]
    whole = [
        dataclasses.replace(person, parts=parts_perfectly(body, poses, CAMERAS, camera))
        for person, camera in zip(plain, recorded, strict=True)
    ]
    names = ("left_wrist", "right_wrist", "left_hand", "right_hand", "head")
    without, found = fit(body, plain, recorded), fit(body, whole, recorded)
    before, after = (turned_off(body, each.poses, poses, names) for each in (without, found))
    assert max(after) < 20
    assert max(after) < 0.5 * min(before[:4])
    assert after[4] < 0.7 * before[4]
    assert without.parts == {}
    assert found.parts == {"left_hand": 1.0, "right_hand": 1.0, "face": 1.0}


def test_parts_that_were_not_found_change_nothing(body: Body, truth: Poses, people):
    parts = parts_perfectly(body, truth, CAMERAS, 0)
    nowhere = dataclasses.replace(
        parts,
        hands=parts.hands + 7.0,
        hand_found=torch.zeros_like(parts.hand_found),
        face_found=torch.zeros_like(parts.face_found),
    )
    plain = fit(body, people[:1], (0,))
    asked = fit(body, [dataclasses.replace(people[0], parts=nowhere)], (0,))
    assert asked.parts == {"left_hand": 0.0, "right_hand": 0.0, "face": 0.0}
    for one, two in zip(motion(plain.poses), motion(asked.poses), strict=True):
        assert torch.allclose(one, two, atol=1e-6)


def test_fingers_bend_only_on_hands_that_were_seen(body: Body, truth: Poses, people):
    parts = parts_perfectly(body, truth, CAMERAS, 0)
    times = torch.arange(FRAMES) / FPS

    def low(**changes) -> list[float]:
        """How far each hand's fingers may bend, degrees."""
        seen = dataclasses.replace(people[0], parts=dataclasses.replace(parts, **changes))
        limits = body_fit._problem(body, CAMERAS, (0,), [seen], times, True)[0].limits
        rows = [SMPL_JOINT_NAMES.index(name) - 1 for name in ("left_hand", "right_hand")]
        reach = torch.maximum(-limits.low[rows, 2], limits.high[rows, 2])
        return torch.rad2deg(reach).tolist()

    assert low() == pytest.approx([110, 110])
    found = parts.hand_found.clone()
    found[:, 1] = False
    assert low(hand_found=found) == pytest.approx([110, 10])
    assert low(hand_found=torch.zeros_like(found)) == pytest.approx([10, 10])


def test_a_view_that_the_others_gainsay_turns_no_hand(body: Body, truth: Poses, people):
    """It follows another person, as well seen as she is: her hands' parts are not this body's."""
    stranger = dataclasses.replace(
        people[1],
        points=people[1].points + 25.0,
        parts=dataclasses.replace(
            parts_perfectly(body, truth, CAMERAS, 1),
            hands=parts_perfectly(body, truth, CAMERAS, 1).hands + 25.0,
        ),
    )
    times = torch.arange(FRAMES) / FPS
    strangers = [people[0], stranger, *people[2:]]
    problem = body_fit._problem(body, CAMERAS, ALL, strangers, times, True)[0]
    assert problem.parts is not None
    assert problem.parts.weights.max() == 0
    asked = dataclasses.replace(people[1], parts=parts_perfectly(body, truth, CAMERAS, 1))
    same = [people[0], asked, *people[2:]]
    agreed = body_fit._problem(body, CAMERAS, ALL, same, times, True)[0]
    assert agreed.parts is not None
    assert agreed.parts.weights[1].min() > 0.9


def sitting_up(body: Body) -> Poses:
    """On her back, legs bent, raising the trunk; the camera sees her from the side."""
    poses, swing = walking_poses(body, FRAMES), torch.linspace(0, 1, FRAMES)
    pose = torch.zeros_like(poses.body_pose)
    for joint, degrees in (("hip", -70 - 50 * swing), ("knee", 100 + 0 * swing)):
        for side in ("left", "right"):
            pose[:, SMPL_JOINT_NAMES.index(f"{side}_{joint}") - 1, 0] = torch.deg2rad(degrees)
    lean, turned = torch.zeros(FRAMES, 3), torch.zeros(FRAMES, 3)
    lean[:, 0], turned[:, 1] = torch.deg2rad(-80 + 40 * swing), math.pi / 2
    orient = axis_angle_to_matrix(turned) @ axis_angle_to_matrix(lean)
    return dataclasses.replace(
        poses, body_pose=pose, global_orient=matrix_to_axis_angle(orient),
        transl=torch.zeros(FRAMES, 3),
    )  # fmt: skip


def test_who_lies_with_bent_legs_that_are_hardly_believed_is_found_in_any_pose(body: Body):
    truth = sitting_up(body)
    seen = detect_perfectly(body, truth, CAMERAS, 0)
    assert seen.world is not None
    times = torch.arange(FRAMES) / FPS
    problems = [
        body_fit._problem(body, CAMERAS, (0,), [seen], times, any_pose)[0]
        for any_pose in (False, True)
    ]
    assert problems[1].extent > 1.1 * problems[0].extent
    visibility, legs = seen.visibility.clone(), slice(25, 33)
    visibility[:, legs] *= 0.4  # as detectors have it of people on the floor
    world = seen.world * torch.tensor([0.75, 1.25, 1.0])  # and their shape in space
    doubted = dataclasses.replace(seen, visibility=visibility, world=world)
    usual, lying = (
        joint_errors(
            posed_joints(body, *motion(fit(body, [doubted], (0,), any_pose=any_pose).poses)),
            posed_joints(body, *motion(truth)),
        )["registered_mm"]
        for any_pose in (False, True)
    )
    assert lying < 0.8 * usual, (usual, lying)


HIDDEN_ARM = [13, 15, 17, 19, 21]  # MediaPipe's left elbow, wrist and hand


def with_hidden_arm(person: Landmarks) -> Landmarks:
    """Nobody sees her left arm: the detector says so, and places it at the shoulder."""
    points, visibility = person.points.clone(), person.visibility.clone()
    points[:, HIDDEN_ARM], visibility[:, HIDDEN_ARM] = points[:, [11]], 0.01
    return dataclasses.replace(person, points=points, visibility=visibility)


def test_an_arm_that_no_picture_shows_lies_where_it_is_guessed_in_any_pose(
    body: Body, truth: Poses, monkeypatch: pytest.MonkeyPatch
):
    pose = truth.body_pose.clone()
    pose[:, SMPL_JOINT_NAMES.index("left_elbow") - 1] = torch.tensor([0.0, -1.8, 0.0])
    bent = dataclasses.replace(truth, body_pose=pose)
    seen = with_hidden_arm(detect_perfectly(body, bent, CAMERAS, 0))
    arm = [SMPL_JOINT_NAMES.index(name) for name in ("left_elbow", "left_wrist")]

    def off() -> float:
        found = posed_joints(body, *motion(fit(body, [seen], (0,), any_pose=True).poses))
        true = posed_joints(body, *motion(bent))
        apart = (found - found[:, :1]) - (true - true[:, :1])
        return float(apart[:, arm].norm(dim=-1).mean())

    guessed = off()
    monkeypatch.setattr(monocular_prior, "HIDDEN", 0.0)
    assert guessed < 0.6 * off()


def test_the_guess_of_what_is_hidden_is_believed_and_of_mistakes_is_not(
    body: Body, people: list[Landmarks]
):
    seen = with_hidden_arm(dataclasses.replace(people[0], found=people[0].found.clone()))
    seen.points[5, 28] += torch.tensor([80.0, -60.0])  # the right ankle jumps away and back
    seen.visibility[:, 26] = 0.6
    seen.found[0] = False
    sure = {}
    for any_pose in (False, True):
        problem = body_fit._problem(
            body, CAMERAS, (0,), [seen], torch.arange(FRAMES) / FPS, any_pose
        )
        assert problem[0].one is not None
        rows = problem[0].marks.rows
        believed = problem[0].one.sure
        sure[any_pose] = {mark: believed[:, rows.index(mark)] for mark in (13, 15, 26, 28)}
        assert believed[0].max() == 0
        assert sure[any_pose][28][5] == 0
        assert sure[any_pose][26][1:].tolist() == pytest.approx([0.6] * (FRAMES - 1))
    for mark in (13, 15):
        assert sure[False][mark][1:].max() == pytest.approx(0.01)
        assert sure[True][mark][1:].tolist() == pytest.approx([0.3] * (FRAMES - 1))


def test_bent_joints_cost_less_in_any_pose_and_those_near_rest_the_same(
    body: Body, people: list[Landmarks]
):
    times = torch.arange(FRAMES) / FPS

    def cost(degrees: float, any_pose: bool) -> float:
        problem, transl = body_fit._problem(body, CAMERAS, (0,), people[:1], times, any_pose)
        still, pose = (
            torch.zeros(len(transl), 3),
            torch.zeros(len(transl), len(body.parents) - 1, 3),
        )
        pose[:, SMPL_JOINT_NAMES.index("left_knee") - 1, 0] = math.radians(degrees)
        unknowns = body_fit._Unknowns(
            torch.zeros(body.shape_dirs.shape[2]), still, pose.flatten(1), transl,
            problem.marks.offsets, PART_MAP.offsets,
        )  # fmt: skip
        return float(body_fit._priors(problem, unknowns, body_fit._pose(problem, unknowns)))

    near, far = (
        [cost(degrees, any_pose) - cost(0.0, any_pose) for any_pose in (False, True)]
        for degrees in (5.0, 120.0)
    )
    assert near[1] == pytest.approx(near[0], rel=0.02, abs=1e-3)
    assert far[1] < 0.6 * far[0]
