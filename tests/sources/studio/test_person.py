import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.posed_body import posed_vertices
from deblur_avatar.sources.studio.motion import Moves, move
from deblur_avatar.sources.studio.person import Person, create_person

TIMES = torch.tensor([0.0, 0.34, 0.9])


@pytest.fixture(scope="module")
def person(body: Body) -> Person:
    return create_person(body, torch.tensor([2.0, -0.5]))


def test_bare_hands_are_where_the_bodys_hands_are(person: Person):
    moves = move("turn", TIMES, 1.0)
    bodies = posed_vertices(
        person.body, person.betas.double(), moves.global_orient, moves.body_pose, moves.transl
    )
    hands = person.body.lbs_weights[:, 22:].sum(1) > 0.5
    for clothed, bare in zip(person.posed(moves), bodies[:, hands].numpy(), strict=True):
        away, _ = cKDTree(clothed).query(bare)
        assert away.max() < 1e-5


def test_moving_the_person_moves_every_point(person: Person):
    moves = move("turn", TIMES[:1], 1.0)
    shift = torch.tensor([[1.0, -2.0, 0.5]]).double()
    there = Moves(moves.global_orient, moves.body_pose, moves.transl + shift)
    (before,), (after,) = person.posed(moves), person.posed(there)
    np.testing.assert_allclose(after - before, np.broadcast_to(shift, before.shape), atol=1e-5)


def test_shape_reaches_the_clothes(body: Body, person: Person):
    shorter = create_person(body, torch.tensor([-2.0, -0.5]))
    ratio = np.ptp(person.drape.vertices[:, 1]) / np.ptp(shorter.drape.vertices[:, 1])
    assert ratio == pytest.approx(1.1 / 0.9, abs=0.02)


def test_hollows_are_darker_than_what_lies_open(person: Person):
    centres = person.drape.vertices[person.mesh.faces].mean(1)
    brightness = person.mesh.albedo[:, 0, 0].sum(-1)
    neck = np.linalg.norm(centres - (0.0, 0.6, -0.02), axis=1) < 0.06  # inside head and trunk
    hand = np.abs(centres[:, 0]) > 0.85
    assert neck.sum() > 10
    assert brightness[neck].mean() < 0.75 * brightness[hand].mean()
    assert person.mesh.albedo.max() <= 1
