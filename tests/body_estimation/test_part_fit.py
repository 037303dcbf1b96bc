import dataclasses

import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.bodies.posed_body import joint_transforms, shaped_joints
from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.body_estimation.part_fit import (
    GROUPS,
    HAND_ROWS,
    PART_MAP,
    Parts,
    gather_parts,
    part_cost,
)
from deblur_avatar.body_estimation.robust_costs import growing, saturating
from tests.walking_person import detect_perfectly, parts_perfectly, ring_of_cameras, walking_poses

FRAMES, SIZE = 3, 80.0  # pixels
CAMERAS = ring_of_cameras()
LENS = CAMERAS.Ks[:1], CAMERAS.viewmats[:1]
LEFT, RIGHT, FACE = GROUPS
AGREED = torch.ones(1, FRAMES, len(GROUPS), dtype=torch.bool)


@pytest.fixture(scope="module")
def poses(body: Body):
    return walking_poses(body, FRAMES)


@pytest.fixture(scope="module")
def person(body: Body, poses) -> Landmarks:
    seen = detect_perfectly(body, poses, CAMERAS, 0)
    return dataclasses.replace(seen, parts=parts_perfectly(body, poses, CAMERAS, 0))


@pytest.fixture(scope="module")
def places(body: Body, poses) -> torch.Tensor:
    motion = poses.betas, poses.global_orient, poses.body_pose, poses.transl
    joints = shaped_joints(body, poses.betas)
    return PART_MAP.positions(joint_transforms(body, *motion), joints, PART_MAP.offsets)


def changed(person: Landmarks, **parts) -> Landmarks:
    assert person.parts is not None
    return dataclasses.replace(person, parts=dataclasses.replace(person.parts, **parts))


def gathered(person: Landmarks) -> Parts:
    parts = gather_parts([person], AGREED)
    assert parts is not None
    return parts


def cost(person: Landmarks, places: torch.Tensor, robust=growing) -> float:
    return float(part_cost(gathered(person), places, *LENS, robust))


def test_the_right_hand_mirrors_the_left_and_the_face_looks_ahead(body: Body):
    still = torch.zeros(1, 3)
    pose = torch.zeros(1, len(body.parents) - 1, 3)
    betas = torch.zeros(body.shape_dirs.shape[2])
    rest = PART_MAP.positions(
        joint_transforms(body, betas, still, pose, still), body.joints, PART_MAP.offsets
    )[0]
    left, right = rest[LEFT], rest[RIGHT]
    assert torch.allclose(left * torch.tensor([-1.0, 1, 1]), right, atol=1e-5)
    root, tip = HAND_ROWS.index(9), HAND_ROWS.index(12)
    assert left[tip, 0] > left[root, 0] > left[0, 0]  # +X from the wrist to the fingertip
    assert left[HAND_ROWS.index(2), 2] > left[root, 2] + 0.03  # the thumb points ahead
    nose, chin, top = rest[FACE][0], rest[FACE][7], rest[FACE][4]
    assert nose[2] == rest[FACE][:, 2].max()
    assert chin[1] < nose[1] < top[1]
    assert rest[FACE][2, 0] > 0 > rest[FACE][3, 0]  # her left eye is on her left


def test_what_is_where_it_was_seen_costs_nothing(person, places):
    assert cost(person, places) < 1e-2


def test_where_a_part_is_does_not_matter_but_how_it_looks_does(person, places):
    parts = person.parts
    moved = changed(person, hands=parts.hands + torch.tensor([1.0, 0.5, 30.0]))
    assert cost(moved, places) == pytest.approx(cost(person, places), abs=1e-2)
    turned = places.clone()
    middle = turned[:, LEFT].mean(1, keepdim=True)
    turned[:, LEFT] = (turned[:, LEFT] - middle) * torch.tensor([-1.0, 1.0, -1.0]) + middle
    assert cost(person, turned) > 20


def test_depth_tells_a_palm_from_a_back(person, places):
    """Mirrored in the picture's plane a part has the same picture, and another depth."""
    centre = torch.linalg.inv(CAMERAS.viewmats[0])[:3, 3]
    along = torch.nn.functional.normalize(places.mean(1, keepdim=True) - centre, dim=-1)
    behind = places.clone()
    for rows in GROUPS:
        away = ((places[:, rows] - places[:, rows].mean(1, keepdim=True)) * along).sum(-1)
        behind[:, rows] = places[:, rows] - 2 * away[..., None] * along
    assert cost(person, behind) > cost(person, places) + 5


@pytest.mark.parametrize(("size", "flat", "deep"), [(80.0, 1.0, 1.92), (500.0, 4.0, 12.0)])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_cost_is_that_of_the_formula(person, places, size, flat, deep, axis):
    """A point of the face off by ten pixels: its part's middle moves, too.

    0.8 % of the size in the picture, but not under a pixel, and 2.4 % in depth.
    """
    face = person.parts.face.clone()
    face[1, 3, axis] += 10.0
    only = changed(
        person,
        face=face,
        hand_found=torch.zeros_like(person.parts.hand_found),
        sizes=torch.full((FRAMES,), size),
    )
    gaps = torch.full((face.shape[1],), -10.0 / face.shape[1])
    gaps[3] += 10.0
    squared = (gaps / (deep if axis == 2 else flat)).square()
    for robust in (growing, saturating):
        assert cost(only, places, robust) == pytest.approx(float(robust(squared).sum()), rel=0.05)


def test_gradients_are_those_of_differences(person, places):
    parts = gathered(changed(person, hands=person.parts.hands * 1.02))
    start = places.double().requires_grad_()
    lens = tuple(part.double() for part in LENS)
    parts = Parts(*(part.double() for part in parts))

    def value(at: torch.Tensor) -> torch.Tensor:
        return part_cost(parts, at, *lens, saturating)

    (gradient,) = torch.autograd.grad(value(start), start)
    step = torch.zeros_like(places.double())
    step[1, 4] = torch.tensor([1e-5, -2e-5, 1e-5]).double()
    difference = (value(start.detach() + step) - value(start.detach() - step)) / 2
    # A part's distance, by which its depth is measured, counts as known.
    assert float((gradient * step).sum()) == pytest.approx(float(difference), rel=0.02)


@pytest.mark.parametrize("side", [0, 1])
def test_hands_go_to_the_side_they_are_of(person, side):
    """Each wrist was looked at and the other hand was found there, as where hands are clasped."""
    hands = person.parts.hands.flip(1)
    exchanged = changed(person, hands=hands, left=person.parts.left.flip(1))
    straight, crossed = gathered(person), gathered(exchanged)
    assert torch.equal(straight.seen[:, :, GROUPS[side]], crossed.seen[:, :, GROUPS[side]])
    assert crossed.weights[..., side] == pytest.approx(0.98, abs=1e-5)


def test_hands_that_cannot_be_hers_are_left_out(person):
    parts = person.parts
    other_side = changed(person, left=1 - parts.left)
    assert gathered(other_side).weights[..., :2].max() == 0
    far = parts.hands.clone()
    far[0, 0, :, 0] += 0.1 * SIZE
    weights = gathered(changed(person, hands=far)).weights[0]
    assert weights[:, 0].tolist() == pytest.approx([0, 0.98, 0.98])
    assert weights[:, 1].tolist() == pytest.approx([0.98] * 3)
    larger = changed(person, hands=far, sizes=torch.full((FRAMES,), 2.5 * SIZE))
    assert gathered(larger).weights[0, 0, 0] == pytest.approx(0.98)
    unseen = person.visibility.clone()
    unseen[1, 16] = 0.1
    weights = gathered(dataclasses.replace(person, visibility=unseen)).weights[0]
    assert weights[:, 1].tolist() == pytest.approx([0.98, 0, 0.98])


def test_a_face_that_is_not_where_her_nose_is_is_left_out(person):
    """A bystander's in the same box, or one that is seen in the back of a head."""
    face = person.parts.face.clone()
    face[0, :, 1] += 0.1 * SIZE
    turned_away = person.visibility.clone()
    turned_away[2, 0] = 0.1
    her = dataclasses.replace(changed(person, face=face), visibility=turned_away)
    assert gathered(her).weights[0, :, 2].tolist() == [0, 1, 0]


def test_frames_without_her_and_views_that_are_gainsaid_have_no_parts(person):
    found = torch.tensor([True, False, True])
    weights = gathered(dataclasses.replace(person, found=found)).weights[0]
    assert (weights[1] == 0).all()
    assert (weights[[0, 2]] > 0).all()
    agreed = AGREED.clone()
    agreed[0, 2, 1] = False
    doubted = gather_parts([person], agreed)
    assert doubted is not None
    assert (doubted.weights[0] == 0).nonzero().tolist() == [[2, 1]]


def test_nothing_is_made_of_parts_that_nobody_looked_for(person):
    assert gather_parts([dataclasses.replace(person, parts=None)], AGREED) is None
    both = AGREED.expand(2, -1, -1)
    two = gather_parts([dataclasses.replace(person, parts=None), person], both)
    assert two is not None
    assert two.weights[0].max() == 0
    assert two.shares()["face"] == 0.5


def test_hands_are_seen_each_for_itself_and_not_by_a_face(person):
    assert gathered(person).hands_seen() == ("left_hand", "right_hand")
    right_alone = person.parts.hand_found.clone()
    right_alone[:, 0] = False
    assert gathered(changed(person, hand_found=right_alone)).hands_seen() == ("right_hand",)
    assert gathered(changed(person, hand_found=right_alone & False)).hands_seen() == ()
    once = Parts(torch.zeros(1, 100, 30, 3), torch.zeros(1, 100, 3), torch.ones(1, 100))
    once.weights[0, 7, 0] = 1.0  # one frame of a hundred is a mistake
    assert once.hands_seen() == ()


def test_all_joints_that_carry_parts_are_those_named():
    names = {SMPL_JOINT_NAMES[index] for index in PART_MAP.carriers}
    assert names == {"left_wrist", "left_hand", "right_wrist", "right_hand", "head"}
